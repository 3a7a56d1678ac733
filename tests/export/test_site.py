"""The page without a server: what its program computes is what Python computes, and nothing else runs or leaves it."""

import contextlib
import copy
import functools
import http.server
import itertools
import json
import re
import shutil
import sys
import threading
import urllib.parse

import jax
import numpy as np
import onnx
import pytest
import yaml
from axe_playwright_python import sync_playwright as axe
from tokenizers import Tokenizer

from t2m_jax.checkpoints.bundle import bundle_path, load_training_data
from t2m_jax.checkpoints.model import load_model
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.export.page import site
from t2m_jax.export.page.figure import figure_record
from t2m_jax.export.page.meanings import meanings_record
from t2m_jax.export.render.scene import figure_from_motion
from t2m_jax.files.writing import save_json
from t2m_jax.motion.bvh import save_bvh
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.joining import ease_seams, fade_features, join_windows
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rotations import rotate_vectors
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.sampling import MotionRequest, SamplingOptions, TextToMotion
from t2m_jax.sampling.loop import STOP_STREAM
from t2m_jax.sampling.prompts import sample_key
from t2m_jax.sampling.text_encoders import make_text_encoder
from t2m_jax.text.bpe import TOKENIZER_FILE, save_bpe, train_bpe
from t2m_jax.text.coverage import Knowledge, make_knowledge
from t2m_jax.text.prompts import check_prompt
from tests.clip_golden import FULL
from tests.conftest import REPOSITORY
from tests.export.test_viewer import browser  # noqa: F401 - a fixture
from tests.tiny import BUNDLE, CAPTIONS, HIFIGPT_BUNDLE, random_bundle

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = playwright.expect
WAIT = 120_000
"""Milliseconds in which the page must do something, on a machine whose cores run other tests."""
WAVE = "a person waves with the left hand"
JUMP = "a person jumps forward"
WEB = REPOSITORY / "t2m_jax" / "export" / "page" / "web"
SCRIPTS = sorted(WEB.glob("*.js"))
MINILM = REPOSITORY / "t2m_jax" / "encoders" / "minilm" / "tokenizer.json"
LETTERS = " abcxyz'-.,!?09ÅéßıİΣσςﬁ½²Ⅷ日本語한글абвअा́\u0301\u00a0\u2028\u200d_[]#@€😀\t"


def many_sentences() -> list[str]:
    """Returns sentences of captions, of hard cases, and of random characters."""
    random = np.random.default_rng(0)
    hard = [
        "don't STOP—go",
        "ΣΑΣ ΟΔΟΣ",
        "naïve cafe\u0301",
        "[CLS] and [pad] [unk]x",
        "x" * 101,
        "İstanbul ﬁn½",
        "日本 walks",
    ]
    words = [" ".join(random.permutation(CAPTIONS[k % 5].split())) for k in range(100)]
    return [*CAPTIONS, *hard, *words, *("".join(random.choice([*LETTERS], 30)) for _ in range(100))]


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        """Writes nothing."""


@contextlib.contextmanager
def serving(folder):
    """Serves a folder as `python -m http.server` does, and gives its address."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    stop = contextlib.ExitStack()
    stop.callback(thread.join)
    stop.callback(server.server_close)
    stop.callback(server.shutdown)
    with stop:
        yield f"http://127.0.0.1:{server.server_port}/", stop.close


@pytest.fixture(scope="module")
def modules(browser):  # noqa: F811
    """Returns a function that runs a function of JavaScript with modules of the page, and returns its result."""
    with serving(WEB) as (address, _):
        page = browser.new_page()
        page.goto(f"{address}page.css")

        def run(names, code, given):
            imports = "".join(f"const {name} = await import('/{name}.js');" for name in names.split())
            return page.evaluate(f"async (given) => {{ {imports} {code} }}", given)

        yield run
        page.close()


def own_subwords():
    """Returns subwords such as a caption encoder learns."""
    lines = (REPOSITORY / "configs" / "data" / "sentences.yaml").read_text(encoding="utf-8").splitlines()
    return train_bpe(lines, vocabulary_size=800)


@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda: Tokenizer.from_file(f"{MINILM}"), own_subwords], ids=["minilm", "own"])
def test_sentences_have_the_tokens_of_the_library(modules, make):
    tokenizer = make()
    sentences = many_sentences()
    assert len(sentences) > 200
    code = "const one = new tokenizer.Tokenizer(given.tree); return given.sentences.map((text) => one.encode(text));"
    found = modules("tokenizer", code, {"tree": json.loads(tokenizer.to_str()), "sentences": sentences})
    wanted = tokenizer.encode_batch(sentences)
    for sentence, tokens, encoding in zip(sentences, found, wanted, strict=True):
        assert tokens == encoding.ids, ascii(sentence)


@pytest.mark.slow
def test_the_noise_is_that_of_jax(modules):
    cases = [(0, WAVE, 0), (7, "naïve", 3), (2**32 - 1, "日本", 1)]
    code = """return given.map(([seed, sentence, sample]) => {
      const key = random.sampleKey(seed, sentence, sample);
      const { codes, end } = random.rowNoise(key, 5, { depth: 3, classes: 7 });
      const single = random.rowNoise(key, 5, { depth: 1, classes: 7 });
      return { key, codes: [...codes], end, single: [...single.codes], uniform: [...random.uniform(key, 1000)] };
    });"""
    for case, found in zip(cases, modules("random", code, cases), strict=True):
        key = sample_key(*case)
        np.testing.assert_array_equal(found["key"], jax.random.key_data(key))
        np.testing.assert_array_equal(np.float32(found["uniform"]), jax.random.uniform(key, 1000))
        row = jax.random.fold_in(key, 5)
        wanted = [jax.random.gumbel(one, 7) for one in jax.random.split(row, 3)]
        np.testing.assert_allclose(np.reshape(found["codes"], (3, 7)), wanted, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(found["single"], jax.random.gumbel(row, 7), rtol=1e-5, atol=1e-6)
        stop = jax.random.fold_in(jax.random.fold_in(key, STOP_STREAM), 5)
        np.testing.assert_allclose(found["end"], jax.random.logistic(stop), rtol=1e-5)


@pytest.mark.slow
def test_sentences_are_cleaned_and_refused_as_in_python(modules):
    def cleaned(text):
        try:
            return check_prompt(text)
        except UserError:
            return None

    sentences = [
        *many_sentences(),
        "",
        "...",
        "turns 90°",
        "“quoted” ‘it’",
        "a  b\n c\u200b",
        "wave 👋",
        "x" * 1001,
        "\x07 a",
    ]
    code = """return given.map((text) => {
      try { return sentence.cleanSentence(text); } catch { return null; }
    });"""
    found = modules("sentence", code, sentences)
    wanted = [cleaned(text) for text in sentences]
    assert 100 < sum(text is not None for text in wanted) < len(sentences)
    assert found == wanted


@pytest.mark.slow
def test_words_are_named_that_python_follows_and_the_page_does_not(modules):
    known = make_knowledge(load_training_data(bundle_path("demo"))).actions
    folder = REPOSITORY / "tests" / "text"
    files = [yaml.safe_load((folder / name).read_text()) for name in ("sequence.yaml", "quantities.yaml")]
    entries = [entry for file in files for part in file.values() for entry in part]
    texts = [entry if isinstance(entry, str) else entry["text"] for entry in entries]
    requests = [MotionRequest(captions=(text,)).in_turn(Knowledge(frozenset(), known)) for text in texts]
    # A pace is known to the model itself; Python only takes the best of some samples.
    is_followed = [request.lengths != (None,) or request.times != (None,) for request in requests]
    followed = list(itertools.compress(texts, is_followed))
    assert 150 < len(followed) < len(texts)
    code = "return given.map(sentence.leftToModel);"
    unnamed = [text for text, words in zip(followed, modules("sentence", code, followed), strict=True) if not words]
    assert unnamed == []
    assert modules("sentence", code, [*CAPTIONS, "turns 90 degrees"]) == [[]] * 6
    assert modules("sentence", code, ["walks, then jumps 3 times"]) == [["then", "3"]]


@pytest.fixture
def acrobat(walk):
    """Returns a walk whose body turns over, whose right leg is straight, and whose bones change their lengths."""
    angles = np.linspace(0, 5, walk.num_frames)[:, None]
    upside = quaternion_from_turns(angles, axis=(0.6, 0.0, 0.8))
    positions = rotate_vectors(upside, walk.positions)
    hip, knee, ankle = (walk.skeleton.joint_names.index(f"right_{name}") for name in ("hip", "knee", "ankle"))
    positions[:, knee] = (positions[:, hip] + positions[:, ankle]) / 2
    trembling = np.random.default_rng(0).normal(scale=0.004, size=positions.shape)
    parts = {"part_starts": (0, 33), "part_captions": ('{é} "👋" \\', "stops")}
    return Motion((positions + trembling).astype(np.float32), walk.fps, **parts)


def quaternion_from_turns(angles, *, axis):
    """Returns rotations [T, 1, 4] about an axis."""
    half = angles[..., None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * np.array(axis)], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["walk", "kit_walk"])
def test_the_figure_is_that_of_python(modules, kind, request):
    motion = request.getfixturevalue(kind)
    about = {"fps": motion.fps, "joints": list(motion.skeleton.joint_names)}
    given = {"figure": figure_record(motion.skeleton), "motion": about, "positions": motion.positions.ravel().tolist()}
    given["motion"]["parents"] = list(motion.skeleton.parents)
    code = """checks.checkFigure(given.figure, given.motion.parents);
      const made = figure.makeFigure(Float32Array.from(given.positions), given);
      return { ...made, values: [...made.values] };"""
    found = modules("checks figure", code, given)
    wanted = figure_from_motion(motion)
    np.testing.assert_allclose(np.reshape(found["values"], wanted.points.shape), wanted.points, atol=1e-4)
    np.testing.assert_allclose([part[:4] for part in found["parts"]], [part[:4] for part in wanted.parts], atol=1e-5)
    assert [tuple(one[:2]) for one in found["contacts"]] == [one[:2] for one in wanted.contacts]
    np.testing.assert_allclose([one[2:] for one in found["contacts"]], [one[2:] for one in wanted.contacts], atol=1e-4)


def words_and_numbers(text: str) -> tuple[list[str], np.ndarray]:
    """Returns the words of a BVH file, and its numbers."""
    parts = text.split()
    is_number = [re.fullmatch(r"-?[\d.]+", part) is not None for part in parts]
    numbers = [float(part) for part, one in zip(parts, is_number, strict=True) if one]
    return ["0" if one else part for part, one in zip(parts, is_number, strict=True)], np.array(numbers)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["walk", "acrobat"])
def test_bvh_files_are_those_of_python(modules, kind, request, tmp_path):
    motion = request.getfixturevalue(kind)
    about = {"fps": motion.fps, "parents": list(motion.skeleton.parents), "joints": list(motion.skeleton.joint_names)}
    given = {"figure": figure_record(motion.skeleton), "motion": about, "positions": motion.positions.ravel().tolist()}
    given["parts"] = {"part_starts": motion.part_starts, "part_captions": motion.part_captions}
    code = """const frames = figure.framesOf(Float32Array.from(given.positions), given.motion.joints.length);
      const fitted = rig.fitRig(frames, given.motion, given.figure.rig);
      return bvh.bvhText(fitted, given.motion, given.figure.rig, given.parts);"""
    text = modules("bvh figure rig", code, given)
    save_bvh(tmp_path / "python.bvh", motion)
    (words, numbers), (wanted_words, wanted) = map(words_and_numbers, (text, (tmp_path / "python.bvh").read_text()))
    assert words == wanted_words
    np.testing.assert_allclose(numbers, wanted, atol=0.01)  # degrees and meters
    (tmp_path / "page.bvh").write_text(text)
    found, expected = (load_motion(tmp_path / f"{name}.bvh").positions for name in ("page", "python"))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def shaped(rows) -> np.ndarray:
    """Returns rows of numbers as positions of two joints."""
    return np.reshape(rows, (-1, 2, 3))


@pytest.mark.slow
def test_sentences_follow_each_other_as_in_python(modules):
    random = np.random.default_rng(0)
    first, second, short, long = (random.normal(size=(frames, 6)) for frames in (30, 20, 3, 90))
    given = {"first": first, "second": second, "short": short, "long": long, "fps": 10}
    given = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in given.items()}
    code = """const { first, second, short, long, fps } = given;
      return {
        faded: chain.fadeFeatures(first, second, fps), shortly: chain.fadeFeatures(first, short, 20),
        eased: chain.easeSeams(long, [2, 30, 36], fps),
        joined: await chain.inWindows(long, 40, fps, async (rows) => rows.map((row) => row.map((value) => 2 * value))),
        mixed: await chain.inWindows(long, 40, fps, async (rows) => rows.map((row, place) => row.map(() => place))),
      };"""
    found = modules("chain", code, given)
    for name, pair, overlap in (("faded", (first, second), 4), ("shortly", (first, short), 8)):
        for ours, theirs in zip(found[name], fade_features(*pair, overlap=overlap), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-6)
    points = long.reshape(-1, 2, 3).astype(np.float32)
    np.testing.assert_allclose(shaped(found["eased"]), ease_seams(points, [2, 30, 36], fps=10.0), atol=1e-5)
    windows = [points[first : first + 40] for first in (0, 20, 40, 60)]
    doubled = join_windows([2 * window for window in windows], count=90, overlap=20)
    np.testing.assert_allclose(shaped(found["joined"]), doubled, atol=1e-5)
    places = [np.arange(len(window), dtype=np.float32)[:, None, None] + 0 * window for window in windows]
    np.testing.assert_allclose(shaped(found["mixed"]), join_windows(places, count=90, overlap=20), atol=1e-5)


MANIFEST = {
    "format_version": 1,
    "license": "mit",
    "source": "tiny",
    "examples": ["a person walks"],
    "graphs": {
        "text": {"inputs": {"tokens": [1, 4], "num_tokens": [1]}, "outputs": {"text_embedding": [1, 3]}},
        "begin": {"inputs": {"text_embedding": [1, 3]}, "outputs": {"cache": [1]}},
        "row": {
            "inputs": {"noise": [1, 2, 5], "temperature": [1], "may_stop": [1], "cache": [1]},
            "outputs": {"codes": [1, 2], "stop_score": [1], "next_cache": [1]},
        },
        "decode": {"inputs": {"codes": [1, 9, 2], "num_rows": [1]}, "outputs": {"features": [1, 36, 7]}},
        "place": {"inputs": {"features": [1, 72, 7]}, "outputs": {"positions": [1, 72, 2, 3]}},
        "calm": {
            "inputs": {"positions": [1, 36, 2, 3], "num_frames": [1]},
            "outputs": {"calm_positions": [1, 36, 2, 3]},
        },
        "lock": {
            "inputs": {"calm_positions": [1, 36, 2, 3], "positions": [1, 36, 2, 3], "num_frames": [1]},
            "outputs": {"clean_positions": [1, 36, 2, 3]},
        },
    },
    "text": {"max_tokens": 4},
    "sampling": {
        "max_rows": 9,
        "min_rows": 1,
        "state": ["cache"],
        "next": "next_",
        "guidance_scale": None,
        "stop": {"rule": "end", "threshold": 0.5, "keeps_last": False},
    },
    "motion": {
        "fps": 20,
        "frames_per_row": 4,
        "joints": ["root", "head"],
        "parents": [-1, 0],
        "rest_offsets": [[0, 0, 0], [0, 1, 0]],
    },
}
for _graph in MANIFEST["graphs"].values():
    for _side in _graph.values():
        _side |= {name: {"shape": shape, "dtype": "float32"} for name, shape in _side.items()}
HOSTILE = {
    "graphs.row.inputs.noise.shape": ["</script>", [1, 10**6, 10**6], None, [-1, 2, 3]],
    "graphs.row.inputs.noise.dtype": ["string", 3],
    "graphs.place": [None, {}],
    "graphs.place.inputs.features.shape": [[1, 7], [10**6, 10**6, 3]],
    "graphs.lock.inputs.positions.shape": [[1, 10**6, 10**6, 3], ["x"]],
    "graphs.text": [None, "https://elsewhere.example/text.onnx", {}],
    "graphs": [[], None, {}],
    "text.max_tokens": [10**9, -1, "4", 0.5],
    "sampling.max_rows": [10**9, 0, "9", None],
    "sampling.state": [["__proto__"], ["a b"], "cache", [{}]],
    "sampling.next": ["__proto__", 3],
    "sampling.stop.rule": ["constructor", None, "eval"],
    "motion.fps": [0, "20", 1e400],
    "motion.joints": [["<img src=x onerror=alert(1)>", "head"], [], ["root"] * 1000],
    "motion.parents": [[-1, 1], [0, 0], [-1]],
    "motion.rest_offsets": [[[0, 0], [0, 1, 0]], "x"],
    "examples": [[3], "a", ["x" * 1000]],
    "license": [{"toString": "x"}, 3],
    "format_version": [2, "1", None],
}


HOSTILE_FIGURE = {
    "weights": [[], [["x"] * 22] * 22, [[0] * 22] * 10**4],
    "parts": ["x", [[0, 1, 0.1, 0.1, "</script>"]], [[0, 999, 0.1, 0.1, 0]]],
    "roles.legs": [[[0, 1, 2], [3, 4, 99]], None],
    "sizes": [{"leg": "1em"}, None],
    "rig": [[], "x", {}, 3],
    "rig.names": [["a b"] * 22, ["}\nMOTION"] * 22, ["__proto__"] * 22, ["Hips"]],
    "rig.hubs": [[[0, 1, 2, 99]] * 2, [[1, 2, 3, 4]] * 2, [[0, 1, 2, 3]], [[0, 1, 2, 3], [9, 13, 14, 15]]],
    "rig.limbs": [[{"start": 0, "hinge": 4, "axis": [1, 0, 0]}], [{"start": 1, "hinge": 4, "axis": "x"}], {}],
    "rig.spine": [[21], ["3"]],
    "rig.ankles": [[10], None],
    "rig.sweeps": [10**9, -1, "20"],
    "rig.twist.angles": [10**9, 0, 0.5],
    "rig.twist.speed": [-1, None, "fast"],
}


def changed(path: str, value, whole: dict = MANIFEST) -> dict:
    """Returns a tree with another value at a place."""
    tree = copy.deepcopy(whole)
    *way, last = path.split(".")
    functools.reduce(lambda part, name: part[name], way, tree)[last] = value
    return tree


@pytest.mark.slow
def test_a_hostile_manifest_is_refused(modules):
    code = """return given.map((tree) => {
      try { checks.checkManifest(JSON.parse(tree)); return null; } catch (error) { return error.message; }
    });"""
    cases = [(path, value) for path, values in HOSTILE.items() for value in values]
    trees = [json.dumps(MANIFEST), *(json.dumps(changed(*case)) for case in cases), "null", "[]", "3", '"x"']
    trees = [tree.replace("Infinity", "1e400") for tree in trees]
    fine, *answers = modules("checks", code, trees)
    assert fine is None
    for case, answer in zip([*cases, *trees[-4:]], answers, strict=True):
        assert answer and answer.startswith("manifest.json: "), case
    files = {"model/a.onnx": {"bytes": 3, "sha256": "0" * 64}}
    wrong = [
        {"../index.html": files["model/a.onnx"]},
        {"https://elsewhere.example/a": files["model/a.onnx"]},
        {"model/../../a": files["model/a.onnx"]},
        {"model/a": {"bytes": 10**12, "sha256": "0" * 64}},
        {"model/a": {"bytes": 3, "sha256": "x"}},
        [],
    ]
    code = "return given.map((tree) => { try { return checks.checkFiles(tree).size; } catch { return null; } });"
    assert modules("checks", code, [files, *wrong]) == [1] + [None] * len(wrong)


MEANINGS = {"compared": 2, "sentences": ["a", "b"], "learned": [[1, -2, 127]], "missing": [[3, 0, 0], [0, 3, 0]]}
HOSTILE_MEANINGS = {
    "compared": [0, 10**9, "2"],
    "sentences": ["a", ["a"], ["a", 3], ["x" * 1000, "b"]],
    "learned": [[], "x", [[1, 2]], [[1, 2, 0.5]], [[1, 2, 1000]], [["1", 2, 3]], [[1, 2, 3]] * 2000],
    "missing": [[], [[3, 0, 0]], [[3, 0, 0], {}], None],
}


@pytest.mark.slow
def test_hostile_meanings_are_refused(modules):
    code = """return given.map(([tree, shape]) => {
      try {
        checks.checkMeanings(tree, shape && { shape });
        return null;
      } catch (error) {
        return error.message;
      }
    });"""
    cases = [(path, value) for path, values in HOSTILE_MEANINGS.items() for value in values]
    trees = [(changed(*case, MEANINGS), [1, 3]) for case in cases]
    trees += [(MEANINGS, None), (MEANINGS, [1, 4]), (None, [1, 3]), ([], [1, 3])]
    fine, *answers = modules("checks", code, [(MEANINGS, [1, 3]), *trees])
    assert fine is None
    for tree, answer in zip(trees, answers, strict=True):
        assert answer and answer.startswith("meanings.json: "), tree


@pytest.mark.slow
def test_what_the_data_lack_is_found_as_in_python(modules):
    bundle = load_model("demo-free")
    learned, missing = bundle.training_data["learned"], bundle.training_data["missing"]
    known = [*learned, *missing, "he throws punches", "someone waves cars through"]
    # All at once, in batches as the record has them: the encoder is compiled for each size.
    embedded = dict(zip(known, make_text_encoder(bundle).sentence_embeddings(known), strict=True))

    def embed(texts):
        return np.stack([embedded[text] for text in texts])

    python = make_knowledge(bundle.training_data, embed).meanings
    sentences = [*missing, *learned[::12], *known[-2:]]
    wanted = [python.missing(sentence) for sentence in sentences]
    assert wanted[: len(missing)].count("") < 3 < wanted.count("")
    code = "return given.meanings.map((meaning) => meanings.findMissing(given.record, meaning));"
    given = {"record": meanings_record(bundle), "meanings": embed(sentences).tolist()}
    assert modules("meanings", code, given) == wanted
    assert meanings_record(random_bundle(HIFIGPT_BUNDLE)) is None


@pytest.mark.slow
def test_what_a_graph_computes_must_be_as_the_manifest_says(modules):
    code = """const outputs = { positions: { dtype: "float32", shape: [1, 2] } };
    const right = { type: "float32", dims: [1, 2], data: new Float32Array([1, 2]) };
    const changes = [{}, { type: "int32" }, { dims: [2, 1] }];
    for (const value of [NaN, Infinity]) changes.push({ data: new Float32Array([1, value]) });
    return [...changes.map((change) => ({ positions: { ...right, ...change } })), {}].map((tensors) => {
      try {
        return checks.checkOutputs("place", outputs, tensors).positions.length;
      } catch (error) {
        return error.message;
      }
    });"""
    wrong = "place.onnx: the output positions is not as it must be; export the page again"
    assert modules("checks", code, None) == [2] + [wrong] * 5


@pytest.mark.slow
def test_a_hostile_figure_is_refused(modules):
    code = """return given.trees.map((tree) => {
      try { checks.checkFigure(JSON.parse(tree), given.parents); return null; } catch (error) { return error.message; }
    });"""
    figure = figure_record(HUMANML3D)
    cases = [(path, value) for path, values in HOSTILE_FIGURE.items() for value in values]
    trees = [figure, *(changed(*case, figure) for case in cases), None, [], 3]
    given = {"trees": list(map(json.dumps, trees)), "parents": list(HUMANML3D.parents)}
    fine, *answers = modules("checks", code, given)
    assert fine is None
    for case, answer in zip([*cases, *trees[-3:]], answers, strict=True):
        assert answer and answer.startswith("figure.json: "), case


def test_the_program_makes_no_markup_or_code_of_texts():
    for script in SCRIPTS:
        text = script.read_text(encoding="utf-8")
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacent|document\.write|\beval\(|new Function|https?://\w", text
        ), script
    page = (WEB / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://| on\w+=|<script>|<style| style=", page)
    assert "unsafe-inline" not in site.POLICY and "default-src 'none'" in site.POLICY


def test_without_the_extra_there_is_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert main(["export", "page", "no-such-model", f"{tmp_path / 'page'}"]) == 2
    assert capsys.readouterr().err == "t2m: error: export: onnxruntime is missing; pip install 't2m-jax[onnx]'\n"


def test_a_tokenizer_that_the_page_cannot_read_is_refused(tmp_path):
    save_bpe(tmp_path, own_subwords())
    for path in (MINILM, tmp_path / TOKENIZER_FILE):
        site._check_tokenizer(path)
    with pytest.raises(UserError, match="has a tokenizer that the page cannot read"):
        site._check_tokenizer(FULL / "tokenizer.json")


@pytest.fixture
def open_site(browser):  # noqa: F811
    """Returns a function that opens a page; afterwards nothing may have gone wrong, and nothing left the origin."""
    troubles, contexts = [], []

    def open_page(address, *, path="", expected="", **options):
        context = browser.new_context(**({"reduced_motion": "reduce"} | options))
        contexts.append(context)
        context.set_default_timeout(WAIT)
        page = context.new_page()
        page.on("console", lambda message: troubles.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("dialog", lambda dialog: troubles.append(f"dialog: {dialog.message}"))
        own = (address, "data:", f"blob:{address}")
        context.on("request", lambda sent: troubles.append(sent.url) if not sent.url.startswith(own) else None)
        page.goto(address + path)
        if not expected:
            expect(page.locator("#generate")).to_be_enabled(timeout=WAIT)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert troubles == []


def make(page, sentence, seed):
    page.get_by_role("textbox", name="Sentence").fill(sentence)
    page.get_by_role("textbox", name="Seed").fill(str(seed))
    page.get_by_role("button", name="Generate").click()
    expect(page.locator("#take-facts")).to_contain_text(f"seed\u00a0{seed}", timeout=WAIT)
    expect(page.locator("#generate")).to_be_enabled(timeout=WAIT)


def download(page, name, tmp_path):
    """Returns the motion of a file that the page makes."""
    with page.expect_download() as info:
        page.get_by_role("button", name=f"Download {name}").click()
    path = tmp_path / f"motion.{name.lower()}"
    info.value.save_as(path)
    return load_motion(path)


def python_motion(model, sentence, seed, **options):
    request = MotionRequest(
        captions=tuple(sentence.split("\n")), seed=seed, options=SamplingOptions(whole=True, **options)
    )
    (motion,) = model.make(request)
    return motion


@pytest.fixture(scope="module")
def free_site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site") / "free"
    site.export_page(folder, load_model("demo-free"))
    return folder


@pytest.fixture(scope="module")
def small_site(tmp_path_factory):
    """The page of a model that is exported and runs much faster."""
    folder = tmp_path_factory.mktemp("site") / "small"
    site.export_page(folder, random_bundle(HIFIGPT_BUNDLE))
    return folder


@pytest.mark.slow
def test_motions_and_the_history_are_there_without_a_network(open_site, small_site, tmp_path):
    with serving(small_site) as (address, stop):
        page = open_site(address)
        for number, sentence in enumerate(CAPTIONS[:2]):
            make(page, sentence, number)
            expect(page.locator(".take")).to_have_count(number + 1)
        made = download(page, "NPZ", tmp_path)
        page.get_by_role("button", name="Delete all").click()
        expect(page.locator(".take")).to_have_count(0)
        page.get_by_role("button", name="Undo").click()
        expect(page.locator(".take")).to_have_count(2)
        link = page.url
        stop()
        page.goto("about:blank")
        page.goto(link)
        expect(page.locator("#take-facts")).to_contain_text("seed\u00a01", timeout=WAIT)
        np.testing.assert_array_equal(download(page, "NPZ", tmp_path).codes, made.codes)
        expect(page.locator(".take")).to_have_count(2)
        make(page, CAPTIONS[2], 2)
        # Only the codes are compared, so nothing is cleaned, which takes long to compile.
        wanted = python_motion(TextToMotion(random_bundle(HIFIGPT_BUNDLE)), CAPTIONS[2], 2, raw=True)
        np.testing.assert_array_equal(download(page, "NPZ", tmp_path).codes, wanted.codes)


@pytest.mark.slow
@pytest.mark.release
def test_a_sentence_becomes_the_motion_of_python(open_site, free_site, tmp_path):
    assert sum(path.stat().st_size for path in free_site.rglob("*") if path.is_file()) < 60e6
    model = TextToMotion.load("demo-free")
    with serving(free_site) as (address, _):
        page = open_site(address)
        expect(page.locator("#license")).to_contain_text("cc-by-4.0")
        expect(page.locator("#formats")).to_be_hidden()
        assert page.evaluate("crossOriginIsolated")
        for number, seed in enumerate((7, 8)):
            make(page, JUMP, seed)
            found, wanted = download(page, "NPZ", tmp_path), python_motion(model, JUMP, seed)
            np.testing.assert_array_equal(found.codes, wanted.codes)
            assert np.abs(found.positions - wanted.positions).max() < 1e-3
            assert np.abs(found.positions_raw - wanted.positions_raw).max() < 1e-3
            assert np.abs(found.positions - found.positions_raw).max() > 1e-3
            assert (found.caption, found.seed, found.fps) == (JUMP, seed, 20)
            np.testing.assert_allclose(download(page, "GLB", tmp_path).positions, found.positions, atol=1e-4)
            download(page, "BVH", tmp_path)
            save_bvh(tmp_path / "python.bvh", found)
            texts = [(tmp_path / f"{name}.bvh").read_text() for name in ("motion", "python")]
            (words, numbers), (wanted_words, wanted_numbers) = map(words_and_numbers, texts)
            assert words == wanted_words
            np.testing.assert_allclose(numbers, wanted_numbers, atol=0.01)  # degrees and meters
            expect(page.locator(".take")).to_have_count(number + 1)
        expect(page.locator("#status")).not_to_contain_text("have no motion")
        make(page, "a person jumps twice", 9)
        expect(page.locator("#status")).to_contain_text("left to the model here (“twice”)")
        wanted = python_motion(model, "a person jumps twice", 9)
        np.testing.assert_array_equal(download(page, "NPZ", tmp_path).codes, wanted.codes)
        make(page, WAVE, 9)
        expect(page.locator("#status")).to_contain_text(f"The training data have no motion like “{WAVE}”")


@pytest.mark.slow
@pytest.mark.parametrize(
    "config", [pytest.param(BUNDLE, marks=pytest.mark.release), HIFIGPT_BUNDLE], ids=["t2m_gpt", "hifigpt"]
)
def test_models_of_users_run(open_site, small_site, config, tmp_path):
    bundle = random_bundle(config)
    folder = small_site
    if config != HIFIGPT_BUNDLE:
        folder = tmp_path / "site"
        site.export_page(folder, bundle)
    model = TextToMotion(bundle)
    with serving(folder) as (address, _):
        page = open_site(address)
        for seed, caption in enumerate(CAPTIONS[:3]):
            temperature = (1.0, 0.5, 0.0)[seed]
            page.get_by_role("spinbutton", name="Temperature").fill(f"{temperature:g}")
            make(page, caption, seed)
            wanted = python_motion(model, caption, seed, temperature=temperature, raw=True)
            np.testing.assert_array_equal(download(page, "NPZ", tmp_path).codes, wanted.codes)
        # The third sentence makes it longer than one window of the clean-up.
        chain = "\n".join(CAPTIONS[:3])
        make(page, f"{CAPTIONS[0]}\n\n {CAPTIONS[1]}\n{CAPTIONS[2]} \n", 5)
        found, wanted = download(page, "NPZ", tmp_path), python_motion(model, chain, 5, temperature=0.0)
        np.testing.assert_array_equal(found.codes, wanted.codes)
        assert (found.part_starts, found.part_captions) == (wanted.part_starts, wanted.part_captions)
        assert found.caption == wanted.caption
        assert np.abs(found.positions_raw - wanted.positions_raw).max() < 1e-3
        assert np.abs(found.positions - wanted.positions).max() < 1e-3
        page.get_by_role("button", name=CAPTIONS[1], exact=True).click()
        expect(page.locator("#clock")).to_contain_text(f"frame {wanted.part_starts[1]}")
        if found.skeleton == HUMANML3D:
            for name in ("BVH", "GLB"):
                copy_of_it = download(page, name, tmp_path)
                assert copy_of_it.part_starts == wanted.part_starts
                assert copy_of_it.part_captions == wanted.part_captions
        page.get_by_role("textbox", name="Sentence").fill("a person walks\n" * (site.MOST_SENTENCES + 1))
        page.get_by_role("button", name="Generate").click()
        expect(page.locator("#message")).to_contain_text("at most 6 sentences", timeout=WAIT)
        page.get_by_role("textbox", name="Seed").fill("one")
        page.get_by_role("button", name="Generate").click()
        expect(page.locator("#message")).to_contain_text("the seed must be a whole number")


@pytest.mark.slow
def test_changed_files_are_refused_and_texts_stay_texts(open_site, small_site, tmp_path):
    folder = shutil.copytree(small_site, tmp_path / "site")
    manifest = json.loads((folder / "model" / "manifest.json").read_text(encoding="utf-8"))
    nasty = "<img src=x onerror=alert(1)>"
    hostile = manifest | {"license": nasty, "source": nasty, "examples": [nasty]}
    save_json(folder / "model" / "manifest.json", hostile)
    with serving(folder) as (address, _):
        page = open_site(address, expected="refused")
        expect(page.locator("#message")).to_contain_text("model/manifest.json", timeout=WAIT)
        expect(page.locator("#generate")).to_be_disabled()
        # The wrong file is not kept: with the right one, the page works.
        (folder / "model" / "manifest.json").write_bytes((small_site / "model" / "manifest.json").read_bytes())
        page.reload()
        expect(page.locator("#generate")).to_be_enabled(timeout=WAIT)
        save_json(folder / "model" / "manifest.json", hostile)
        # As that of another skeleton.
        figure = json.loads((folder / "model" / "figure.json").read_text(encoding="utf-8"))
        save_json(folder / "model" / "figure.json", figure | {"rig": None})
        # With a list that fits, it is used, as text.
        save_json(folder / "files.json", site._checked_files(folder))
        page = open_site(address)
        expect(page.locator("#examples button")).to_have_text(nasty)
        expect(page.locator("#license")).to_contain_text(nasty)
        assert page.locator("img").count() == 0
        assert page.locator("#downloads button").all_inner_texts() == ["NPZ"]
        expect(page.locator("#formats")).to_be_visible()
        (folder / "model" / "row.onnx").write_bytes(b"no graph")
        save_json(folder / "files.json", site._checked_files(folder))
        page = open_site(address, expected="refused")
        expect(page.locator("#message")).to_contain_text("The page cannot start", timeout=WAIT)
        # Valid graphs that compute something else.
        (folder / "model" / "row.onnx").write_bytes((small_site / "model" / "row.onnx").read_bytes())
        place = onnx.load(folder / "model" / "place.onnx")
        (value,) = place.graph.output
        short = onnx.helper.make_tensor("short", onnx.TensorProto.FLOAT, [1], [0.0])
        constant = onnx.helper.make_node("Constant", [], [value.name], value=short)
        graph = onnx.helper.make_graph(
            [constant], "other", place.graph.input, [onnx.helper.make_tensor_value_info(value.name, 1, [1])]
        )
        other = onnx.helper.make_model(graph, opset_imports=place.opset_import, ir_version=place.ir_version)
        onnx.save(other, folder / "model" / "place.onnx")
        save_json(folder / "files.json", site._checked_files(folder))
        page = open_site(address)
        page.get_by_role("textbox", name="Sentence").fill(JUMP)
        page.get_by_role("button", name="Generate").click()
        expect(page.locator("#message")).to_contain_text("place.onnx: the output positions", timeout=WAIT)


@pytest.mark.slow
@pytest.mark.release
def test_the_page_is_accessible_and_fits_screens(open_site, free_site):
    with serving(free_site) as (address, _):
        fields = urllib.parse.urlencode({"sentence": JUMP, "seed": 3, "samples": 2})
        page = open_site(address, path=f"#make?{fields}", color_scheme="dark")
        expect(page.locator("#take-facts")).to_contain_text("1 of 2", timeout=WAIT)
        for theme in ("light", "dark"):
            page.get_by_role("combobox", name="Colors").select_option(theme)
            for width in (390, 768, 1440):
                page.set_viewport_size({"width": width, "height": 900})
                assert page.evaluate("document.documentElement.scrollWidth") <= width
                assert [fault["id"] for fault in axe.Axe().run(page).response["violations"]] == []
