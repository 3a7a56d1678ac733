"""A seed gives the same numbers, whatever settings of JAX are."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

import t2m_jax
from t2m_jax.errors import UserError
from t2m_jax.keys import new_key
from t2m_jax.sampling.prompts import sample_key
from t2m_jax.train.streams import stream_key

SETTINGS = {
    "jax_default_prng_impl": "rbg",
    "jax_threefry_partitionable": False,
}


def numbers():
    """Returns numbers of keys for motions and for trainings."""
    keys = (new_key(3), sample_key(3, "a person walks", 1), stream_key(3, "data"), jax.random.split(new_key(5), 3)[1])
    return np.stack([jax.random.uniform(key, (7,)) for key in keys])


@pytest.mark.parametrize("name", SETTINGS)
def test_numbers_of_a_seed_do_not_depend_on_settings(name):
    before, expected = jax.config.values[name], numbers()
    np.testing.assert_array_equal(expected[0][:2], np.float32([0.07405257225036621, 0.938144326210022]))
    # The name of a stream becomes a number that is the same in every process.
    np.testing.assert_array_equal(expected[2][:2], np.float32([0.04528367519378662, 0.16139793395996094]))
    try:
        jax.config.update(name, SETTINGS[name])
        np.testing.assert_array_equal(numbers(), expected)
    finally:
        jax.config.update(name, before)


def test_64_bits_are_refused_in_one_line():
    jax.config.update("jax_enable_x64", True)
    try:
        with pytest.raises(UserError, match="jax_enable_x64: models compute with 32 bits"):
            new_key(0)
    finally:
        jax.config.update("jax_enable_x64", False)


def test_other_numbers_for_a_part_of_a_program_are_refused():
    with jax.threefry_partitionable(False), pytest.raises(UserError, match="a seed would give another motion"):
        new_key(0)


def test_no_other_module_makes_keys():
    package = Path(t2m_jax.__file__).parent
    made = {path for path in package.rglob("*.py") if re.search(r"\b(random\.key|PRNGKey)\(", path.read_text("utf-8"))}
    assert made == {package / "keys.py"}
