"""Motions as codes, and the bank that the GPT trains on."""

import logging
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import vqvae_shapes
from t2m_jax.config import UserError
from t2m_jax.data.code_bank import CodeBatch
from t2m_jax.data.folder import Clip, Dataset, DatasetInfo
from t2m_jax.data.texts import Caption
from t2m_jax.models.vqvae import VqVae
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.text.tokenization import tokenize, train_tokenizer
from t2m_jax.train.run_gpt import load_samples, make_batch
from t2m_jax.train.tokenize import BATCH, encode_batch, encode_motions, make_code_bank
from tests.tiny import CAPTIONS, VQVAE, gpt_training, random_variables

PLAIN = Normalizer(np.zeros(3, np.float32), np.ones(3, np.float32))


@pytest.fixture(scope="module")
def vqvae():
    return VqVae(VQVAE), jax.tree.map(jnp.asarray, random_variables(vqvae_shapes(VQVAE)))


@pytest.fixture(scope="module")
def motions():
    generator = np.random.default_rng(0)
    lengths = [40, 64, 3, 41, 70, *generator.integers(4, 60, BATCH)]
    return [generator.normal(size=(length, 263)).astype(np.float32) for length in lengths]


def test_batched_codes_equal_those_of_each_motion_alone(vqvae, motions):
    model, variables = vqvae
    together = encode_motions(model, variables, motions)
    assert [len(codes) for codes in together] == [len(motion) // 4 for motion in motions]
    for index in (0, 1, 2, 3, 4, len(motions) - 1):
        np.testing.assert_array_equal(together[index], encode_motions(model, variables, [motions[index]])[0])
    unpadded = encode_batch(variables, jnp.asarray(motions[0])[None], jnp.ones((1, 40), bool), vqvae=model)[0]
    np.testing.assert_array_equal(together[0], unpadded)
    assert len({tuple(codes) for codes in together}) > 60, "codes do not depend on the motion"


def test_encoding_equals_eager(vqvae, motions):
    model, variables = vqvae
    motion, mask = jnp.asarray(motions[0])[None, :12], jnp.arange(12)[None] < 10
    jitted = encode_batch(variables, motion, mask, vqvae=model)
    with jax.disable_jit():
        np.testing.assert_array_equal(encode_batch(variables, motion, mask, vqvae=model), jitted)


def counting_clip(name, number, length, captions=()):
    """A clip whose frame f is 100 * number + f in every column."""
    frames = 100.0 * number + np.arange(length, dtype=np.float32)
    return Clip(name, frames[:, None] * np.ones((1, 3), np.float32), tuple(Caption(text) for text in captions))


def first_frames(motions):
    """Stands for a VQ-VAE: the code of four frames is the number of the first."""
    return [motion[: len(motion) // 4 * 4 : 4, 0].astype(np.int32) for motion in motions]


def test_the_bank_holds_codes_at_every_offset_and_all_captions():
    clips = [
        counting_clip("a", 1, 12, CAPTIONS[:2]),
        counting_clip("b", 2, 23, CAPTIONS[2:3]),
        counting_clip("c", 3, 8, CAPTIONS[3:]),
    ]
    tokenizer = train_tokenizer(CAPTIONS, vocabulary_size=90)
    bank = make_code_bank(clips, PLAIN, first_frames, tokenizer, downsample=4, max_caption_tokens=16)
    assert bank.codes.shape == (3, 4, 5)
    for number, clip in enumerate(clips):
        for offset in range(4):
            length = (len(clip.features) - offset) // 4
            assert bank.code_lengths[number, offset] == length
            expected = 100 * (number + 1) + offset + 4 * np.arange(length)
            np.testing.assert_array_equal(bank.codes[number, offset, :length], expected)
            np.testing.assert_array_equal(bank.codes[number, offset, length:], 0)
        own = slice(int(bank.first_caption[number]), int(bank.first_caption[number] + bank.num_captions[number]))
        texts = [caption.text for caption in clip.captions]
        np.testing.assert_array_equal(bank.caption_tokens[own], tokenize(tokenizer, texts, max_length=16).tokens)
    assert len(bank.caption_tokens) == len(CAPTIONS)


def test_the_bank_sees_normalized_motion():
    clip = counting_clip("a", 1, 8, CAPTIONS[:1])
    seen = []

    def encode(motions):
        seen.extend(motions)
        return first_frames(motions)

    normalizer = Normalizer(np.full(3, 50, np.float32), np.full(3, 2, np.float32))
    tokenizer = train_tokenizer(CAPTIONS, vocabulary_size=90)
    make_code_bank([clip], normalizer, encode, tokenizer, downsample=4, max_caption_tokens=8)
    np.testing.assert_allclose(seen[1], (clip.features[1:] - 50) / 2)


def test_no_motion_is_one_line():
    with pytest.raises(UserError, match="no motion with a caption"):
        make_code_bank([], PLAIN, first_frames, train_tokenizer(CAPTIONS, vocabulary_size=90), downsample=4,
                       max_caption_tokens=8)  # fmt: skip


class Fake(Dataset):
    """A data set whose clips are given."""

    def clips(self, split, **options):
        return CLIPS


def tagged(text, start, end):
    return Caption(text, (), start, end)


def clip(name, length, *captions):
    return Clip(name, np.arange(length, dtype=np.float32)[:, None] * np.ones((1, 263), np.float32), captions)


CLIPS = [
    clip("whole", 60, Caption("walks"), Caption("goes")),
    clip("both", 100, Caption("walks, then waves"), tagged("walks", 0.0, 2.0), tagged("waves", 2.5, 5.0)),
    clip("parts", 80, tagged("sits", 1.0, 3.0)),
    clip("long", 300, Caption("walks on")),
    clip("short", 39, Caption("stops")),
    clip("short part", 50, Caption("turns"), tagged("stops", 0.0, 0.5)),
    clip("silent", 60),
]


def test_samples_are_whole_clips_and_time_tagged_parts(caplog):
    info = DatasetInfo(name="fake", min_frames=40, max_frames=196)
    with caplog.at_level(logging.WARNING):
        samples = load_samples(Fake(folder=Path("fake"), info=info, skeleton=HUMANML3D), "train", downsample=4)
    found = [(sample.name, len(sample.features), [caption.text for caption in sample.captions]) for sample in samples]
    assert found == [
        ("whole", 60, ["walks", "goes"]),
        ("both", 100, ["walks, then waves"]),
        ("A_both", 40, ["walks"]),
        ("B_both", 50, ["waves"]),
        ("A_parts", 40, ["sits"]),
        ("short part", 50, ["turns"]),
    ]
    assert samples[3].features[0, 0] == 50
    assert "4 clips of train" in caplog.text


def test_a_sample_too_short_for_every_offset_is_left_out():
    info = DatasetInfo(name="fake", min_frames=1)
    samples = load_samples(Fake(folder=Path("fake"), info=info, skeleton=HUMANML3D), "train", downsample=32)
    assert min(len(sample.features) for sample in samples) >= 64


def test_targets_of_a_batch(tmp_path):
    """Without a key the codes stay; with keys some motions lose one code, at either end, and none gains."""
    config = gpt_training(tmp_path, tmp_path, tmp_path)
    end, pad = config.model.end_token, config.model.pad_token
    codes = jnp.tile(jnp.arange(1, 7), (200, 1))
    batch = CodeBatch(codes, jnp.full(200, 6), jnp.ones((200, 4), int), jnp.ones((200, 4), bool))
    plain = make_batch(batch, None, config=config)
    expected = [1, 2, 3, 4, 5, 6, end, *[pad] * (config.model.block_size - 7)]
    np.testing.assert_array_equal(plain.targets.tokens, np.tile(expected, (200, 1)))
    found = np.asarray(make_batch(batch, jax.random.key(0), config=config).targets.tokens)[:, :7]
    kinds = {(1, 2, 3, 4, 5, 6, end): 0, (2, 3, 4, 5, 6, end, pad): 0, (1, 2, 3, 4, 5, end, pad): 0}
    for row in found.tolist():
        kinds[tuple(row)] += 1
    shares = np.array(list(kinds.values())) / 200
    np.testing.assert_allclose(shares, [2 / 3, 1 / 6, 1 / 6], atol=0.1)
