from importlib.metadata import EntryPoint

import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.errors import UserError
from t2m_jax.motion import formats
from t2m_jax.motion.formats import motion_formats, save_motions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import KIT_ML
from tests.motion.figures import walking_positions


def standing(frames=4, joints=22):
    return np.ones((frames, joints, 3), np.float32)


def write_repr(path, motions):
    path.write_text(repr(motions))


def write_page(path, motions):
    path.write_text(f"<p>{motions[0].num_frames} frames & more</p>")


def read_lines(path):
    return Motion(standing(), 20.0, caption=f"motion of {path.read_text()}")


def read_chosen(path, *, animation=None):
    return Motion(standing(), 20.0, caption=f"{animation} of {path.read_text()}")


def register(monkeypatch, **functions):
    """Makes functions of this file what installed packages offer."""
    points = [EntryPoint(name, f"{__name__}:{function}", "") for name, function in functions.items()]
    monkeypatch.setattr(formats, "_entry_points", formats._entry_points.__wrapped__)  # without its cache
    monkeypatch.setattr(formats, "entry_points", lambda group: points)


def test_a_motion_takes_what_becomes_an_array(unchecked):
    motion = Motion(jnp.ones((4, 22, 3)), 20, features=np.zeros((4, 263)), codes=[1], caption="stands", seed=3)
    assert isinstance(motion.positions, np.ndarray)
    assert motion.positions.dtype == motion.features.dtype == np.float32
    assert (motion.num_frames, motion.seconds, motion.fps) == (4, 0.2, 20.0)
    np.testing.assert_array_equal(motion.codes, [1])
    assert repr(motion) == "Motion(4 frames, 0.20 s, humanml3d, 'stands')"
    assert repr(Motion(standing(5, 21), 12.5, skeleton=KIT_ML)) == "Motion(5 frames, 0.40 s, kit_ml)"


def test_a_motion_may_have_several_layers_of_codes():
    assert Motion(standing(), 20.0, codes=np.zeros((1, 6), np.int32)).codes.shape == (1, 6)


def with_nan():
    positions = standing()
    positions[2, 3, 1] = np.nan
    return positions


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"positions": standing(joints=21)}, r"\(4, 21, 3\); skeleton humanml3d needs \[frames, 22, 3\]"),
        ({"positions": standing(frames=0)}, r"needs \[frames, 22, 3\] with a frame"),
        ({"positions": standing()[0]}, r"\(22, 3\)"),
        ({"positions": with_nan()}, "positions of frame 2 are not finite"),
        ({"positions_raw": with_nan()}, "positions_raw of frame 2 are not finite"),
        ({"positions_raw": standing(joints=21)}, r"positions_raw have shape \(4, 21, 3\)"),
        ({"positions_raw": standing(frames=3)}, "positions_raw have 3 frames, positions 4"),
        ({"fps": 0.0}, r"fps is 0.0; give a number above zero"),
        ({"fps": float("nan")}, "fps is nan"),
        ({"features": np.zeros((3, 263))}, r"\(3, 263\); these positions need \[4, 263\]"),
        ({"codes": np.zeros(2)}, "codes have shape .* give whole numbers"),
        ({"codes": np.zeros((1, 1, 1), int)}, "codes have shape"),
    ],
)
def test_what_is_no_motion_is_refused(unchecked, fields, message):
    with pytest.raises(UserError, match=message):
        Motion(**{"positions": standing(), "fps": 20.0} | fields)


def test_saving_goes_by_the_suffix(monkeypatch, tmp_path):
    register(monkeypatch, txt="write_repr", abc="unknown")
    Motion(standing(), 20.0).save(str(tmp_path / "wave.TXT"))
    assert (tmp_path / "wave.TXT").read_text() == "[Motion(4 frames, 0.20 s, humanml3d)]"
    assert motion_formats() == ("abc", "txt")


@pytest.mark.parametrize("name", ["wave.abc", "wave"])
def test_unknown_suffixes_are_refused_with_the_known_ones(monkeypatch, tmp_path, name):
    register(monkeypatch, txt="write_repr", npz="unknown")
    with pytest.raises(UserError, match=f"{name}: no motion format has the suffix .*; use one of .npz, .txt"):
        Motion(standing(), 20.0).save(tmp_path / name)


def test_files_that_cannot_be_written_are_refused(monkeypatch, tmp_path):
    register(monkeypatch, txt="write_repr")
    with pytest.raises(UserError, match=r"wave.txt: the folder .*missing does not exist"):
        save_motions(tmp_path / "missing" / "wave.txt", [])
    (tmp_path / "wave.txt").mkdir()
    with pytest.raises(UserError, match=r"wave.txt: cannot be written, it is a folder"):
        save_motions(tmp_path / "wave.txt", [])


def fill_the_disk(path, motions):
    raise OSError(28, "No space left on device")


def test_a_disk_that_is_full_is_no_traceback(monkeypatch, tmp_path):
    register(monkeypatch, txt="fill_the_disk")
    with pytest.raises(UserError, match=r"wave.txt: cannot be written \(.*No space left"):
        save_motions(tmp_path / "wave.txt", [])


def test_nothing_registered_says_how_to_install(monkeypatch, tmp_path):
    register(monkeypatch)
    with pytest.raises(UserError, match="pip install -e"):
        Motion(standing(), 20.0).save(tmp_path / "wave.npz")


def test_a_notebook_shows_the_page_of_the_html_format(monkeypatch):
    register(monkeypatch, html="write_page")
    assert 'srcdoc="&lt;p&gt;4 frames &amp; more&lt;/p&gt;"' in Motion(standing(), 20.0)._repr_html_()


def test_loading_goes_by_the_suffix(monkeypatch, tmp_path):
    register(monkeypatch, txt="read_lines", two="read_chosen")
    for suffix in ("TXT", "two"):
        (tmp_path / f"wave.{suffix}").write_text("a file")
    assert Motion.load(str(tmp_path / "wave.TXT")).caption == "motion of a file"
    with pytest.raises(UserError, match=r"animation: .*wave\.TXT has none, as all \.TXT files"):
        formats.load_motion(tmp_path / "wave.TXT", animation="b")
    assert formats.load_motion(tmp_path / "wave.two", animation="b").caption == "b of a file"
    with pytest.raises(
        UserError, match=r"wave\.npz: cannot read motions with the suffix '\.npz'; use one of \.two, \.txt"
    ):
        Motion.load(tmp_path / "wave.npz")


def test_half_characters_in_texts_are_marked(tmp_path):
    half = "a \ud83d person"
    texts = {"caption": half, "warning": half, "unknown_words": (half,), "part_starts": (0,), "part_captions": (half,)}
    motion = Motion(standing(20) + np.arange(22)[:, None] / 10, 20.0, **texts)
    assert {motion.caption, motion.warning, *motion.unknown_words, *motion.part_captions} == {"a \ufffd person"}
    for suffix in ("html", "npz", "glb", "bvh"):
        save_motions(tmp_path / f"a.{suffix}", [motion])
    assert Motion(standing(), 20.0, caption="\ud83d\udc4b").caption == "\N{WAVING HAND SIGN}"


def chain(**fields):
    positions = walking_positions(60)
    parts = {"part_starts": (0, 20, 40), "part_captions": ("he walks", "he waves", "he jumps")}
    caption = {"caption": "he walks, then he waves, then he jumps"}
    return Motion(positions, 20.0, **caption | parts | fields)


@pytest.mark.parametrize(
    ("begin", "end", "starts", "caption"),
    [
        (0.0, 3.0, (0, 20, 40), "he walks, then he waves, then he jumps"),
        (None, 1.5, (0, 20), "he walks, then he waves"),
        (1.5, 2.5, (0, 10), "he waves, then he jumps"),
        (1.0, 2.0, (), "he waves"),
    ],
)
def test_a_part_of_a_motion_has_its_sentences(begin, end, starts, caption):
    part = chain().trimmed(begin, end)
    assert (part.part_starts, part.caption) == (starts, caption)
    assert part.part_captions == tuple(caption.split(", then ") if starts else ())


@pytest.mark.parametrize(
    "span", [(float("nan"), None), (0.0, float("nan")), (-1.0, 2.0), (9.0, None), (1.0, 1.0), (0.01, 0.02)]
)
def test_a_part_without_frames_is_refused(span):
    with pytest.raises(UserError, match="s has no frame; the motion has 3"):
        chain().trimmed(*span)


def test_joined_motions_keep_where_their_sentences_begin():
    single = Motion(walking_positions(30), 20.0, caption="he runs")
    joined = single + chain()
    assert joined.part_starts == (0, 29, 49, 69) and joined.part_captions[0] == "he runs"
    assert joined.caption == "he runs, then he walks, then he waves, then he jumps"
    nothing = Motion(walking_positions(30), 20.0) + Motion(walking_positions(30), 20.0)
    assert (nothing.caption, nothing.part_starts) == ("", ())


def test_a_caption_of_ones_own_stays_with_all_sentences():
    assert chain(caption="a clip").trimmed(0.5).caption == "a clip"
