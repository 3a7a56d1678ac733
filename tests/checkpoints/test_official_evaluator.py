"""The original's evaluator: `finest.tar` read without PyTorch, names and shapes both ways, refusals."""

import json

import jax
import numpy as np
import pytest
from flax import traverse_util
from safetensors.numpy import save_file

from t2m_jax.checkpoints.evaluator import load_trained_evaluator
from t2m_jax.checkpoints.official.load import load_evaluator
from t2m_jax.checkpoints.official.names import EVALUATOR_PARTS, evaluator_weights
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.evaluation.embedding import embed_pieces
from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig, evaluator_shapes
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from tests import golden_files
from tests.checkpoints.torch_archives import number, tensor, text, write_archive
from tests.jit import compiled_apply


def dictionary(entries) -> bytes:
    return b"}(" + b"".join(text(key) + value for key, value in entries.items()) + b"u"


def write_finest(path, state, *, parts=EVALUATOR_PARTS):
    """Writes arrays (part and key, with a dot) as PyTorch writes the original's checkpoint."""
    rows, dictionaries = {}, {}
    for part in parts:
        entries = {}
        for name, array in state.items():
            if name.startswith(f"{part}."):
                key = str(len(rows))
                rows[key] = np.ascontiguousarray(array, np.float32)
                strides = np.cumprod([1, *array.shape[:0:-1]])[::-1]
                entries[name.removeprefix(f"{part}.")] = tensor(
                    array.shape, tuple(map(int, strides)), count=array.size, key=key
                )
        dictionaries[part] = dictionary(entries)
    others = {"opt_text_encoder": dictionary({"state": b"}", "param_groups": b"]"}), "epoch": number(28)}
    return write_archive(path, b"\x80\x02" + dictionary(dictionaries | others) + b".", rows=rows)


@pytest.fixture(scope="module")
def golden(golden_dir):
    with np.load(golden_dir / "evaluation" / "nets_small.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def state(golden):
    return golden_files.evaluator_state_dict(golden)


@pytest.fixture
def table(golden, tmp_path):
    np.save(tmp_path / "table.npy", golden["word_embs"].reshape(-1, golden["word_embs"].shape[-1]))
    return tmp_path / "table.npy"


@pytest.mark.slow
def test_a_checkpoint_of_the_original_embeds_as_the_original(golden, state, table, tmp_path):
    config, variables = load_evaluator(write_finest(tmp_path / "finest.tar", state), word_vectors=table)
    words = np.arange(7 * 22, dtype=np.int32).reshape(7, 22)
    assert config == golden_files.evaluator_config(json.loads(str(golden["config"])), num_words=words.size)
    assert jax.tree.map(np.shape, variables) == jax.tree.map(lambda leaf: leaf.shape, evaluator_shapes(config))
    arguments = [golden["motions"], golden["m_lens"], words, golden["pos_ids"], golden["cap_lens"]]
    found_text, found_motion = compiled_apply(Evaluator(config), variables, *map(jax.numpy.asarray, arguments))
    np.testing.assert_allclose(found_text, golden["text_emb"], rtol=5e-6, atol=5e-6)
    np.testing.assert_allclose(found_motion, golden["motion_emb"], rtol=5e-6, atol=5e-6)


def test_there_and_back_is_bit_identical(state, table, tmp_path):
    config, variables = load_evaluator(write_finest(tmp_path / "finest.tar", state), word_vectors=table)
    flat = traverse_util.flatten_dict(variables)
    back = {
        weight.key: np.ascontiguousarray(flat[weight.path].T if weight.is_reversed else flat[weight.path])
        for weight in evaluator_weights(config)
    }
    assert back.keys() == state.keys()
    for key, array in state.items():
        np.testing.assert_array_equal(back[key], array, err_msg=key)
    save_file(back, tmp_path / "finest.safetensors")
    again = load_evaluator(tmp_path / "finest.safetensors", word_vectors=table)
    assert again[0] == config
    jax.tree.map(np.testing.assert_array_equal, again[1], variables)


def test_without_word_vectors_motions_alone_are_embedded(golden, state, tmp_path):
    config, variables = load_evaluator(write_finest(tmp_path / "finest.tar", state))
    motion, lengths = jax.numpy.asarray(golden["motions"]), jax.numpy.asarray(golden["m_lens"])
    found = compiled_apply(Evaluator(config), variables, motion, lengths, method="embed_motion")
    np.testing.assert_allclose(found, golden["motion_emb"], rtol=5e-6, atol=5e-6)
    assert "word_embedding" not in variables["params"]


@pytest.mark.parametrize(("feature_dim", "movement"), [(263, 1_842_688), (251, 1_818_112)])
def test_full_size_tables(feature_dim, movement):
    config = EvaluatorConfig(feature_dim=feature_dim)
    weights = list(evaluator_weights(config))
    assert len(weights) == 42
    assert len({weight.key for weight in weights}) == len(weights)
    sizes = dict.fromkeys(EVALUATOR_PARTS, 0)
    for weight in weights:
        sizes[weight.key.partition(".")[0]] += int(np.prod(weight.shape))
    assert sizes == {"text_encoder": 4_100_288, "motion_encoder": 15_747_584, "movement_encoder": movement}
    shapes = {weight.key: weight.shape for weight in weights}
    assert shapes["movement_encoder.main.0.weight"] == (512, feature_dim - 4, 4)
    assert shapes["movement_encoder.main.3.weight"] == (512, 512, 4)
    assert shapes["text_encoder.pos_emb.weight"] == (300, 15)
    assert shapes["text_encoder.gru.weight_ih_l0_reverse"] == (1536, 512)
    assert shapes["motion_encoder.hidden"] == (2, 1, 1024)
    assert shapes["motion_encoder.output_net.0.weight"] == (1024, 2048)
    ours = traverse_util.flatten_dict(evaluator_shapes(config))
    ours.pop(("params", "word_embedding", "embedding"))
    placed = {weight.path: weight.shape[::-1] if weight.is_reversed else weight.shape for weight in weights}
    assert placed == {path: leaf.shape for path, leaf in ours.items()}


def refusal(path, **options) -> str:
    with pytest.raises(UserError) as caught:
        load_evaluator(path, **options)
    assert str(caught.value).isprintable()
    return str(caught.value)


def test_what_does_not_fit_is_named(golden_dir, state, table, tmp_path):
    path = tmp_path / "finest.tar"
    key = "text_encoder.gru.weight_hh_l0_reverse"
    less = {name: array for name, array in state.items() if name != key}
    assert refusal(write_finest(path, less)).startswith(f"{path}: array '{key}' is missing")
    assert "has shape (66, 21)" in refusal(write_finest(path, state | {key: state[key][:, :-1]}))
    assert "not finite" in refusal(write_finest(path, state | {key: state[key] * np.nan}))
    assert "is not part of the model" in refusal(write_finest(path, state | {"text_encoder.x": np.ones(2)}))
    assert "'motion_encoder' is missing" in refusal(write_finest(path, state, parts=EVALUATOR_PARTS[:1]))
    assert "'text_encoder' is missing" in refusal(golden_dir / "t2m_gpt" / "ckpt_gpt_small.pth")
    np.save(table, np.ones((3, 5)))
    assert "vectors of 5 numbers" in refusal(write_finest(path, state), word_vectors=table)
    assert "there is no such file" in refusal(path, word_vectors=tmp_path / "none.npy")


@pytest.fixture
def published(golden_dir, tmp_path):
    """The five files of an evaluator of 263 features, statistics being the published ones."""
    with np.load(golden_dir / "evaluation" / "nets_pose263.npz") as file:
        golden = dict(file)
    with np.load(golden_dir / "evaluation" / "evaluator_meta.npz") as meta:
        for name in ("mean", "std"):
            np.save(tmp_path / f"{name}.npy", meta[f"t2m_{name}"])
    write_finest(tmp_path / "finest.tar", golden_files.evaluator_state_dict(golden))
    vectors = golden["word_embs"].reshape(-1, golden["word_embs"].shape[-1])
    np.save(tmp_path / "vectors.npy", vectors)
    words = ["sos", "eos", "unk", *(f"word{number}" for number in range(3, len(vectors)))]
    (tmp_path / "words.txt").write_text("".join(f"{word}\n" for word in words))
    return golden, tmp_path


def convert(folder, *options):
    files = {"evaluator": "finest.tar", "mean": "mean.npy", "std": "std.npy", "words": "words.txt"}
    files["word-vectors"] = "vectors.npy"
    given = [word for name, file in files.items() for word in (f"--{name}", str(folder / file))]
    return main(["convert", "official", *given, *options, str(folder / "evaluator")])


@pytest.mark.slow
def test_published_files_make_an_evaluator(published):
    golden, folder = published
    assert convert(folder) == 0
    evaluator = load_trained_evaluator(folder / "evaluator")
    raw = evaluator.normalizer.denormalize(golden["motions"].astype(np.float64))
    motion = np.where(np.arange(raw.shape[1])[None, :, None] < golden["m_lens"][:, None, None], raw, 0.0)
    pieces = [one[:length] for one, length in zip(motion, golden["m_lens"], strict=True)]
    found = embed_pieces(evaluator, pieces, max_frames=196)
    # Root columns are divided by half a thousandth, which costs three digits of float32.
    np.testing.assert_allclose(found, golden["motion_emb"], atol=2e-3)
    words = [evaluator.vocabulary.words[number] for number in range(3, 6)]
    assert evaluator.vocabulary.vectorize([f"{word}/NOUN" for word in words]).words[1:4].tolist() == [3, 4, 5]


def test_published_statistics_weigh_root_and_contacts_by_25(golden_dir):
    with np.load(golden_dir / "evaluation" / "evaluator_meta.npz") as meta:
        for name in ("t2m", "kit"):
            chance = meta[f"{name}_mean"][-4:]
            deviation = np.sqrt(chance * (1 - chance)).mean()
            np.testing.assert_allclose(TrainEvaluatorConfig().root_weight * meta[f"{name}_std"][-4:], deviation)


def test_files_that_make_no_evaluator_are_refused(published, capsys):
    _, folder = published
    assert convert(folder, "--gpt", "gpt.pth") == 2
    assert "--gpt cannot be used with an evaluator" in capsys.readouterr().err
    assert main(["convert", "official", "--evaluator", "finest.tar", str(folder / "evaluator")]) == 2
    assert (
        "--words, --word-vectors missing; an evaluator needs --evaluator, --mean, --std, --words, --word-vectors"
        in capsys.readouterr().err
    )
    (folder / "words.txt").write_text("sos\neos\nunk\n")
    assert convert(folder) == 2
    assert "words.txt: has 3 words, but" in capsys.readouterr().err
    np.save(folder / "mean.npy", np.zeros(251))
    np.save(folder / "std.npy", np.ones(251))
    assert convert(folder) == 2
    assert "statistics are for 251 features" in capsys.readouterr().err
    assert not (folder / "evaluator").exists()
