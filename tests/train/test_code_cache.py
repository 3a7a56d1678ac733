"""Codes that are kept on disk."""

import logging

import numpy as np
import pytest

from t2m_jax.train.code_cache import cached_codes, code_key

MOTIONS = [np.full((length, 3), length, np.float32) for length in (8, 1, 5)]
CODES = [np.arange(length * 2).reshape(length, 2).astype(np.int32) for length in (4, 0, 300)]


def never():
    raise AssertionError("encoded again")


def kept(places, encode, key="a"):
    return list(cached_codes(places, key, encode))


def assert_codes(found):
    assert len(found) == len(CODES)
    for codes, expected in zip(found, CODES, strict=True):
        assert codes.dtype == np.int32
        np.testing.assert_array_equal(codes, expected)


def test_motions_are_encoded_once(tmp_path):
    assert_codes(kept([tmp_path / "codes"], lambda: iter(CODES)))
    assert_codes(kept([tmp_path / "codes"], never))


def test_other_motions_have_other_codes(tmp_path):
    kept([tmp_path], lambda: CODES)
    assert len(kept([tmp_path], lambda: CODES[:1], key="b")) == 1


def test_no_motion_has_no_codes(tmp_path):
    for _ in range(2):
        assert kept([tmp_path], list) == []


def test_codes_above_65535(tmp_path):
    large = [np.array([[70_000, 0]], np.int32)]
    kept([tmp_path], lambda: large)
    np.testing.assert_array_equal(kept([tmp_path], never), large)


def test_the_second_place_is_used_if_nothing_can_be_written_to_the_first(tmp_path):
    (tmp_path / "file").write_text("")
    places = [tmp_path / "file" / "codes", tmp_path / "codes"]
    assert_codes(kept(places, lambda: CODES))
    assert_codes(kept(places, never))


def test_without_a_place_nothing_is_kept(tmp_path):
    (tmp_path / "file").write_text("")
    for places in ([], [tmp_path / "file" / "codes"]):
        assert_codes(kept(places, lambda: CODES))
        with pytest.raises(AssertionError, match="encoded again"):
            kept(places, never)


@pytest.mark.parametrize("damage", [lambda data: data[:-400], lambda data: b"", lambda data: flip(data, 200)])
def test_damaged_codes_are_made_again(damage, tmp_path, caplog):
    kept([tmp_path], lambda: CODES)
    (path,) = tmp_path.glob("*.npz")
    path.write_bytes(damage(path.read_bytes()))
    with caplog.at_level(logging.WARNING):
        assert_codes(kept([tmp_path], lambda: CODES))
    assert f"{path}: " in caplog.text and "the motions are encoded again" in caplog.text
    assert_codes(kept([tmp_path], never))


def flip(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


def test_keys_differ_in_all_that_decides_the_codes(monkeypatch):
    changed = [MOTIONS[0].copy(), *MOTIONS[1:]]
    changed[0][3, 1] += 1e-6
    others = [MOTIONS, MOTIONS[::-1], MOTIONS[:2], changed, [np.concatenate(MOTIONS)]]
    keys = [code_key("tokenizer", "all", motions) for motions in others]
    keys += [code_key("another", "all", MOTIONS), code_key("tokenizer", "one", MOTIONS)]
    assert code_key("tokenizer", "all", iter(MOTIONS)) == keys[0]
    monkeypatch.setattr("t2m_jax.train.code_cache.version", lambda name: "9.9")
    keys += [code_key("tokenizer", "all", MOTIONS)]
    assert len(set(keys)) == len(keys)
