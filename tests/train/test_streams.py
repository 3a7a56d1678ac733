"""Named streams of keys."""

import itertools

import jax
import numpy as np

from t2m_jax.train.streams import stream_key

NAMES = ("init", "data", "codebook", "validation", "drop", "corruption", "dropout", "tau", "windows", "movements")


def bits(key):
    return tuple(np.asarray(jax.random.key_data(key)).tolist())


def test_all_streams_of_some_seeds_differ():
    keys = [bits(stream_key(seed, name)) for seed, name in itertools.product(range(5), NAMES)]
    assert len(set(keys)) == 5 * len(NAMES)
