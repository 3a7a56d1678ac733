import itertools
import tracemalloc
import zipfile

import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.export.npz import load_npz, save_npz, save_pieces
from t2m_jax.files.reading import MAX_UNPACKED
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from tests.fuzz.attack import peak_memory


def test_everything_comes_back(tmp_path, walk):
    features = np.arange(walk.num_frames * HUMANML3D.feature_dim, dtype=np.float32).reshape(walk.num_frames, -1)
    codes = np.arange(20)[:, None]
    raw = walk.positions + np.float32(0.01)
    motion = Motion(
        walk.positions,
        20.0,
        positions_raw=raw,
        features=features,
        codes=codes,
        caption="walks\n👋 </script>",
        seed=2**40,
    )
    save_npz(tmp_path / "a.npz", [motion])
    back = load_npz(tmp_path / "a.npz")
    np.testing.assert_array_equal(back.positions, motion.positions)
    np.testing.assert_array_equal(back.positions_raw, raw)
    np.testing.assert_array_equal(back.features, features)
    np.testing.assert_array_equal(back.codes, motion.codes)
    assert np.load(tmp_path / "a.npz")["codes"].shape == (20,)
    assert (back.fps, back.caption, back.seed, back.skeleton) == (20.0, motion.caption, 2**40, HUMANML3D)


def test_what_is_unknown_stays_unknown(tmp_path, kit_walk):
    save_npz(tmp_path / "a.npz", [kit_walk])
    back = load_npz(tmp_path / "a.npz")
    assert back.features is None and back.codes is None and back.seed is None
    assert back.skeleton is KIT_ML and back.fps == 12.5
    with np.load(tmp_path / "a.npz") as archive:
        assert set(archive.files) == {"positions", "fps", "caption", "skeleton"}


def test_one_motion_a_file(tmp_path, walk):
    for motions in ([], [walk, walk]):
        with pytest.raises(UserError, match="exactly one motion"):
            save_npz(tmp_path / "a.npz", motions)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_small_file_that_unpacks_to_much_is_refused_before_it_is_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(3):
            archive.writestr(f"{number}.npy", bytes(MAX_UNPACKED // 2))
    before = peak_memory()
    with pytest.raises(UserError, match=r"a\.npz: unpacks to 402,653,184 bytes; at most 268,435,456 are read"):
        load_npz(tmp_path / "a.npz")
    assert peak_memory() - before < 2**24


GOOD = {"positions": np.zeros((2, 22, 3), np.float32), "fps": np.float64(20)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": None}, "no entry 'positions'"),
        ({"fps": None}, "no entry 'fps'"),
        ({"extra": np.zeros(1)}, "unknown entry 'extra'"),
        ({"positions": np.zeros((2, 22), np.float32)}, "'positions' should hold real numbers"),
        ({"positions": np.zeros((2, 21, 3), np.float32)}, "needs"),
        ({"positions": np.full((2, 22, 3), np.nan)}, "not finite"),
        ({"fps": np.float64(0)}, "fps"),
        ({"fps": np.array("20")}, "'fps' should hold"),
        ({"codes": np.zeros(3)}, "'codes' should hold whole numbers"),
        ({"caption": np.zeros(3)}, "'caption' should hold one text"),
        ({"skeleton": np.array("spider")}, "unknown skeleton 'spider'"),
        ({"positions": np.array([{"a": 1}], dtype=object)}, "'positions' is damaged or holds Python objects"),
    ],
)
def test_wrong_entries_are_named(tmp_path, change, message):
    path = tmp_path / "wrong.npz"
    entries = {key: value for key, value in (GOOD | change).items() if value is not None}
    np.savez(path, **entries)
    with pytest.raises(UserError, match=message) as caught:
        load_npz(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_broken_files_are_refused(tmp_path, walk):
    path = tmp_path / "a.npz"
    save_npz(path, [walk])
    whole = path.read_bytes()
    for content in (b"", b"no archive at all", whole[: len(whole) // 2], whole[:400] + b"?" * 400 + whole[800:]):
        path.write_bytes(content)
        with pytest.raises(UserError, match=r"a\.npz"):
            load_npz(path)
    np.save(tmp_path / "single.npy", walk.positions)
    (tmp_path / "single.npy").rename(path)
    with pytest.raises(UserError, match=r"not a complete \.npz file"):
        load_npz(path)
    with pytest.raises(UserError, match="no such file"):
        load_npz(tmp_path / "absent.npz")


@pytest.mark.parametrize("depth", [1, 3])
def test_pieces_are_the_file_of_the_whole(tmp_path, walk, depth):
    features = np.arange(walk.num_frames * HUMANML3D.feature_dim, dtype=np.float32).reshape(walk.num_frames, -1)
    codes = np.arange(walk.num_frames * depth, dtype=np.int32).reshape(-1, depth)
    fields = {"caption": "walks, then 👋", "seed": 2**32 - 1, "warning": "not known", "unknown_words": ("👋",)}
    whole = Motion(
        walk.positions,
        20.0,
        features=features,
        codes=codes,
        part_starts=(0, 9),
        part_captions=("walks", "👋"),
        **fields,
    )
    parts = {0: ((0,), ("walks",)), 4: ((5,), ("👋",)), 20: ((), ())}
    cuts = [*parts, walk.num_frames]
    pieces = [
        Motion(
            walk.positions[first:last],
            20.0,
            features=features[first:last],
            codes=codes[first:last],
            part_starts=parts[first][0],
            part_captions=parts[first][1],
            **fields,
        )
        for first, last in itertools.pairwise(cuts)
    ]
    assert save_pieces(tmp_path / "pieces.npz", iter(pieces)) == walk.num_frames
    save_npz(tmp_path / "whole.npz", [whole])
    with np.load(tmp_path / "pieces.npz") as found, np.load(tmp_path / "whole.npz") as expected:
        assert set(found.files) == set(expected.files)
        for key in expected.files:
            assert found[key].dtype == expected[key].dtype
            np.testing.assert_array_equal(found[key], expected[key])
    assert load_npz(tmp_path / "pieces.npz").part_captions == ("walks", "👋")


def test_pieces_of_nothing_are_refused_and_nothing_is_left(tmp_path, walk):
    with pytest.raises(UserError, match="no pieces"):
        save_pieces(tmp_path / "a.npz", [])
    with pytest.raises(UserError, match=r"\.npz files only"):
        save_pieces(tmp_path / "a.bvh", [walk])
    assert list(tmp_path.iterdir()) == []


def test_pieces_need_the_memory_of_one(tmp_path, walk):
    piece = Motion(np.resize(walk.positions, (1000, 22, 3)), 20.0)

    def most_memory(count):
        tracemalloc.start()
        save_pieces(tmp_path / "a.npz", itertools.repeat(piece, count))
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    few = most_memory(80)  # NumPy compresses 16 MB at a time
    assert most_memory(200) < few + piece.positions.nbytes
    assert load_npz(tmp_path / "a.npz").num_frames == 200_000
