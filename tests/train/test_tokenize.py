"""Motions as codes, and the bank that the GPT trains on."""

import dataclasses
import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.checkpoints import TrainedTokenizer
from t2m_jax.data.banks.codes import CodeBank, code_batch_at
from t2m_jax.data.folder import Clip, DatasetInfo
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.models.system import variable_shapes
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.text.bpe import tokenize_captions, train_bpe
from t2m_jax.train import tokenize as train_tokenize
from t2m_jax.train.gpt import make_targets, training_batch
from t2m_jax.train.tokenize import (
    CodingOptions,
    balanced_weights,
    encode_clips,
    fill_rows,
    make_code_bank,
    with_share,
)
from tests.tiny import CAPTIONS, LOOP, VQVAE, gpt_training, random_variables

INFO = DatasetInfo(name="fake", min_frames=40, max_frames=196)


@pytest.fixture(scope="module")
def vqvae():
    normalizer = Normalizer(np.zeros(263, np.float32), np.ones(263, np.float32))
    return TrainedTokenizer(VQVAE, jax.tree.map(jnp.asarray, random_variables(variable_shapes(VQVAE))), normalizer)


def tagged(text, start, end):
    return Caption(text, (), start, end)


def clip(name, length, *captions):
    """A clip whose frame f is f in every column."""
    return Clip(name, np.arange(length, dtype=np.float32)[:, None] * np.ones((1, 263), np.float32), captions)


CLIPS = [
    clip("whole", 60, Caption("walks"), Caption("goes")),
    clip("both", 101, Caption("walks, then waves"), tagged("walks", 0.0, 2.0), tagged("waves", 2.5, 5.0)),
    clip("parts", 80, tagged("sits", 1.0, 3.0)),
    clip("long", 300, Caption("walks on")),
    clip("short", 39, Caption("stops")),
    clip("short part", 50, Caption("turns"), tagged("stops", 0.0, 0.5), tagged("nothing", 3.0, 4.0)),
    clip("silent", 60),
]


@pytest.fixture
def first_frames(monkeypatch):
    """Replaces the VQ-VAE: the code of four frames is the number of the first."""

    def encode(_, motions, *, progress):
        return [motion[: len(motion) // 4 * 4 : 4, :1].astype(np.int32) for motion in motions]

    monkeypatch.setattr(train_tokenize, "encode_motions", encode)


def coded(vqvae, clips, *, info=INFO, **options):
    options = {"offsets": "all", "timed_captions": "encode", "seed": 5} | options
    return encode_clips(clips, info, vqvae, CodingOptions(**options))


def texts(motions):
    return [[caption.text for caption in motion.captions] for motion in motions]


def assert_same_codes(found, expected):
    assert texts(found) == texts(expected)
    for motion, same in zip(found, expected, strict=True):
        for codes, read in zip(motion.variants, same.variants, strict=True):
            np.testing.assert_array_equal(codes, read)


def test_codes_are_read_again(first_frames, vqvae, tmp_path, monkeypatch):
    ways = [CodingOptions(offsets, "encode", seed=seed) for offsets in ("all", "one", "hold") for seed in (5, 6)]
    first = [encode_clips(CLIPS, INFO, vqvae, way, [tmp_path]) for way in ways]
    for way, motions in zip(ways, first, strict=True):
        assert_same_codes(motions, encode_clips(CLIPS, INFO, vqvae, way))  # none are those of another way
    monkeypatch.setattr(train_tokenize, "encode_motions", None)
    for way, motions in zip(ways, first, strict=True):
        assert_same_codes(encode_clips(CLIPS, INFO, vqvae, way, [tmp_path]), motions)
    with pytest.raises(TypeError):  # these frames have not been encoded
        encode_clips([clip("whole", 64, Caption("walks"))], INFO, vqvae, ways[0], [tmp_path])


def test_motions_are_whole_clips_and_time_tagged_parts(first_frames, vqvae, caplog):
    with caplog.at_level(logging.WARNING):
        motions = coded(vqvae, CLIPS)
    assert texts(motions) == [["walks", "goes"], ["walks, then waves"], ["walks"], ["waves"], ["sits"], ["turns"]]
    assert [len(motion.variants) for motion in motions] == [4] * 6
    assert [len(motion.variants[0]) for motion in motions] == [15, 25, 10, 12, 10, 12]
    assert motions[3].variants[0][0, 0] == 50, "the part does not start at its time"
    assert [int(codes[0, 0]) for codes in motions[0].variants] == [0, 1, 2, 3]
    assert "4 of 7 clips are not used whole" in caplog.text


def test_parts_can_be_cut_out_of_the_whole_clips_codes(first_frames, vqvae):
    motions = coded(vqvae, CLIPS, timed_captions="slice", offsets="one")
    # The 0.5 seconds of "stops" are two codes here, and what lies past the clip's end is none.
    assert texts(motions) == [["walks", "goes"], ["walks, then waves"], ["walks"], ["waves"], ["sits"], ["turns"],
                              ["stops"]]  # fmt: skip
    assert all(len(motion.variants) == 1 for motion in motions)
    whole, walks, waves = (motion.variants[0] for motion in motions[1:4])
    np.testing.assert_array_equal(walks, whole[0:10])
    np.testing.assert_array_equal(waves, whole[12:25])
    assert [len(motion.variants[0]) for motion in motions[4:]] == [10, 12, 2]


def test_one_offset_is_drawn_for_each_clip_and_leaves_the_number_of_codes(first_frames, vqvae):
    clips = [clip(f"clip {number}", 63, Caption("walks")) for number in range(200)]
    starts = [int(motion.variants[0][0, 0]) for motion in coded(vqvae, clips, offsets="one")]
    np.testing.assert_allclose(np.bincount(starts) / 200, 1 / 4, atol=0.1)
    assert starts == [int(motion.variants[0][0, 0]) for motion in coded(vqvae, clips, offsets="one")]
    assert {len(motion.variants[0]) for motion in coded(vqvae, clips, offsets="one")} == {15}
    even = [clip(f"clip {number}", 64, Caption("walks")) for number in range(20)]
    assert {int(motion.variants[0][0, 0]) for motion in coded(vqvae, even, offsets="one")} == {0}


def moving(length, *, still_begin, still_end):
    """Features of somebody whose joints move at 2 m/s, but for frames at an end; the height tells the frame."""
    features = np.zeros((length, 263), np.float32)
    features[:, HUMANML3D.layout.root_height] = np.arange(length)[:, None] + 1
    features[:, HUMANML3D.layout.root_velocity] = 0.1
    features[:, HUMANML3D.layout.velocities] = 0.1 / np.sqrt(3)
    for frame, is_still in ((0, still_begin), (-1, still_end)):
        if is_still:
            features[frame, HUMANML3D.layout.velocities] = 0.0
            features[frame, HUMANML3D.layout.root_velocity] = 0.0
    return features


@pytest.mark.parametrize("start", [0, 3, 7])
@pytest.mark.parametrize("length", [60, 64, 199])
def test_poses_at_rest_are_held_until_rows_are_full(length, start):
    features = moving(length, still_begin=True, still_end=True)
    filled = fill_rows(features, start, downsample=8, most=25, skeleton=HUMANML3D)
    height = filled[:, HUMANML3D.layout.root_height.start]
    assert len(filled) <= 200
    if (length + start + 7) // 8 <= 25:
        assert len(filled) % 8 == 0
        assert (height[: start + 1] == 1).all() and height[start + 1] == 2, "it does not begin as the clip"
        assert height[-1] == length, "it does not end as the clip"
        np.testing.assert_array_equal(filled[:start, HUMANML3D.layout.root_velocity], 0.0)
        np.testing.assert_array_equal(filled[start : start + length], features)


def test_motion_that_begins_or_ends_with_moving_feet_stays_as_it_is():
    features = moving(61, still_begin=False, still_end=False)
    np.testing.assert_array_equal(fill_rows(features, 3, downsample=8, most=25, skeleton=HUMANML3D), features)
    ends_still = moving(61, still_begin=False, still_end=True)
    filled = fill_rows(ends_still, 3, downsample=8, most=25, skeleton=HUMANML3D)
    assert len(filled) == 64 and (filled[61:, HUMANML3D.layout.root_height.start] == 61).all()


def waving(length):
    """Features of somebody who stands, and whose right hand rises by 2 m/s."""
    columns = HUMANML3D.layout
    features = np.zeros((length, 263), np.float32)
    features[:, columns.positions.start + 3 * 20 + 1] = 0.1 * np.arange(length)
    features[:, columns.velocities.start + 3 * 21 + 1] = 0.1
    return features


def test_a_hand_that_moves_comes_out_of_rest_and_to_rest():
    features = waving(61)
    filled = fill_rows(features, 7, downsample=8, most=25, skeleton=HUMANML3D)
    assert len(filled) == 72
    np.testing.assert_array_equal(filled[7:68], features)
    heights = filled[:, HUMANML3D.layout.positions.start + 3 * 20 + 1]
    speeds = filled[:, HUMANML3D.layout.velocities.start + 3 * 21 + 1]
    np.testing.assert_allclose(np.diff(heights), speeds[:-1], atol=1e-5, err_msg="it does not move as its speeds say")
    assert (np.diff(speeds[:8]) > 0).all() and (np.diff(speeds[67:]) < 0).all()
    assert speeds[0] < 0.01 and speeds[-1] < 0.02


def test_held_poses_are_encoded(first_frames, vqvae):
    still = Clip("still", moving(61, still_begin=True, still_end=True), (Caption("waits"),))
    (motion,) = coded(vqvae, [still], offsets="hold")
    assert [len(codes) for codes in motion.variants] == [16, 16, 16, 16]
    assert len(coded(vqvae, [still], offsets="all")[0].variants[1]) == 15


def test_a_motion_too_short_for_every_offset_is_left_out(first_frames, vqvae):
    clips = [clip("seven", 7, Caption("a")), clip("eight", 8, Caption("b"))]
    assert texts(coded(vqvae, clips, info=DatasetInfo(name="fake"))) == [["b"]]


def test_no_motion_is_one_line(first_frames, vqvae):
    with pytest.raises(UserError, match="no motion with a caption has"):
        coded(vqvae, CLIPS[-1:])


def test_the_bank_holds_codes_at_every_offset_and_all_captions(first_frames, vqvae):
    clips = [clip("a", 12, *map(Caption, CAPTIONS[:2])), clip("b", 23, *map(Caption, CAPTIONS[2:]))]
    motions = coded(vqvae, clips, info=DatasetInfo(name="fake"))
    tokenizer = train_bpe(CAPTIONS, vocabulary_size=90)
    bank = make_code_bank(motions, lambda captions: tokenize_captions(tokenizer, captions, max_length=16))
    assert bank.codes.shape == (2, 4, 5, 1)
    for number, one in enumerate(clips):
        for offset in range(4):
            length = (len(one.features) - offset) // 4
            assert bank.code_lengths[number, offset] == length
            np.testing.assert_array_equal(bank.codes[number, offset, :length, 0], offset + 4 * np.arange(length))
            np.testing.assert_array_equal(bank.codes[number, offset, length:], 0)
        own = slice(int(bank.first_caption[number]), int(bank.first_caption[number] + bank.num_captions[number]))
        expected = tokenize_captions(tokenizer, [caption.text for caption in one.captions], max_length=16).tokens
        np.testing.assert_array_equal(bank.captions.tokens[own], expected)
    assert len(bank.captions.tokens) == len(CAPTIONS)


@pytest.mark.slow
def test_the_bank_can_hold_embeddings(first_frames, vqvae):
    motions = coded(vqvae, CLIPS)
    bank = make_code_bank(motions, lambda captions: np.arange(len(captions), dtype=np.float32)[:, None])
    batch = code_batch_at(bank, jax.random.key(0), 0, batch_size=6, max_codes=20)
    assert batch.captions.shape == (6, 1)
    assert bank.captions.shape == (7, 1)


@pytest.mark.slow
def test_targets_of_a_batch(tmp_path):
    """In validation the codes stay; in training some motions lose one code, at either end, and none gains."""
    config = gpt_training(tmp_path, tmp_path, tmp_path, loop=dataclasses.replace(LOOP, batch_size=200))
    config = dataclasses.replace(config, tau=0.0, drop_probability=0.6)
    end = config.model.end_token
    pad = end + 1
    codes, lengths = np.tile(np.arange(1, 7), (200, 1)), np.full(200, 6)
    plain = make_targets(jnp.asarray(codes), jnp.asarray(lengths), config=config.model)
    expected = [1, 2, 3, 4, 5, 6, end, *[pad] * (config.model.block_size - 7)]
    np.testing.assert_array_equal(plain.tokens, np.tile(expected, (200, 1)))
    bank = CodeBank(
        codes[:, None, :, None], lengths[:, None], np.ones((200, 4), np.float32), np.arange(200), np.ones(200, np.int32)
    )
    batch = training_batch(bank, jnp.array(0), config=config)
    found = np.asarray(batch.tokens)[:, :7]
    np.testing.assert_array_equal(batch.inputs, batch.tokens[:, :-1])
    kinds = {(1, 2, 3, 4, 5, 6, end): 0, (2, 3, 4, 5, 6, end, pad): 0, (1, 2, 3, 4, 5, end, pad): 0}
    for row in found.tolist():
        kinds[tuple(row)] += 1
    shares = np.array(list(kinds.values())) / 200
    np.testing.assert_allclose(shares, [0.4, 0.3, 0.3], atol=0.1)


def test_long_clips_may_be_cut_into_windows(first_frames, vqvae):
    motions = coded(vqvae, CLIPS, long_clips="windows")
    windows = [motion for motion in motions if texts([motion]) == [["walks on"]]]
    assert [int(motion.variants[0][0, 0]) for motion in windows] == [0, 52, 104]
    assert len(motions) == 6 + len(windows) and all(len(motion.variants[0]) == 49 for motion in windows)


def test_windows_cover_a_clip_and_lose_captions_with_times():
    long = clip("long", 1000, Caption("walks on"), tagged("stops", 1.0, 2.0))
    windows = train_tokenize.cut_windows(long, INFO)
    starts = [int(window.features[0, 0]) for window in windows]
    assert starts[0] == 0 and starts[-1] == 1000 - 196 and max(np.diff(starts)) <= 98
    assert {window.captions for window in windows} == {(Caption("walks on"),)}
    assert train_tokenize.cut_windows(CLIPS[0], INFO) == [CLIPS[0]]
    assert train_tokenize.cut_windows(clip("tiny", 3), INFO)[0].name == "tiny"


def test_parts_know_their_clip(first_frames, vqvae):
    assert [motion.clip for motion in coded(vqvae, CLIPS[:3])] == ["whole", "both", "both", "both", "parts"]


def test_shares_balance_actions():
    actions = [["walk"]] * 8 + [["wave"]] * 2 + [["jump"]]

    def weight_of_actions(**options):
        weights = balanced_weights(actions, **options)
        return np.array([weights[:8].sum(), weights[8:10].sum(), weights[10]]) / weights.sum()

    np.testing.assert_allclose(weight_of_actions(power=1.0, limit=100.0), [1 / 3, 1 / 3, 1 / 3], rtol=1e-5)
    roots = np.sqrt([8, 2, 1])
    np.testing.assert_allclose(weight_of_actions(power=0.5, limit=100.0), roots / roots.sum(), rtol=1e-5)
    # A motion has 1.5 times the mean weight at most, before weights are made shares again.
    weights = np.array([1 / 8, 1.5 * 3 / 11, 1.5 * 3 / 11])
    expected = weights * [8, 2, 1] / (weights @ [8, 2, 1])
    np.testing.assert_allclose(weight_of_actions(power=1.0, limit=1.5), expected, rtol=1e-5)


def test_a_motion_of_several_actions_is_drawn_as_often_as_these():
    actions = [["walk"], ["walk"], ["jump"], ["walk", "jump"], ["walk", "walk"]]
    weights = balanced_weights(actions, power=1.0, limit=100.0)
    # Four motions have a walk, two a jump.
    expected = np.array([1 / 4, 1 / 4, 1 / 2, 3 / 8, 1 / 4])
    np.testing.assert_allclose(weights, expected, rtol=1e-5)


def test_chosen_motions_get_their_share_and_keep_their_proportions():
    weights = with_share(np.array([1.0, 3.0, 5.0, 15.0]), np.array([True, True, False, False]), 0.8)
    np.testing.assert_allclose(weights, [0.2, 0.6, 0.05, 0.15])
