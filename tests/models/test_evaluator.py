"""The evaluator's networks: the original's numbers, what lies past the end, and the parameter tree."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import traverse_util

from t2m_jax.checkpoints.official.load import evaluator_variables
from t2m_jax.losses import movement_loss
from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig, MovementDecoder, MovementEncoder, evaluator_shapes
from tests.golden_files import evaluator_config, evaluator_state_dict, plain_variables
from tests.jit import compiled_apply

TOLERANCE = 5e-6
"""Of |a - b| / (1 + |b|), as the reference's README suggests."""


def assert_close(ours, theirs):
    error = np.abs(np.asarray(ours) - theirs) / (1 + np.abs(theirs))
    assert error.max() < TOLERANCE, error.max()


class Golden:
    """A file of the reference: its arrays, and our evaluator with its weights."""

    def __init__(self, path):
        with np.load(path) as arrays:
            self.arrays = {name: arrays[name] for name in arrays}
        # The reference reads word vectors themselves: here every word of every caption is one of its own.
        vectors = self["word_embs"]
        self.words = np.arange(vectors.shape[0] * vectors.shape[1]).reshape(vectors.shape[:2])
        self.config = evaluator_config(json.loads(str(self["config"])), num_words=self.words.size)
        table = vectors.reshape(-1, vectors.shape[-1])
        self.variables = evaluator_variables(evaluator_state_dict(self.arrays), self.config, table)

    def __getitem__(self, name):
        return self.arrays[name]

    def embed_motion(self, motion, lengths):
        arguments = (jnp.asarray(motion), jnp.asarray(lengths))
        return compiled_apply(Evaluator(self.config), self.variables, *arguments, method="embed_motion")

    def embed_text(self):
        rows = map(jnp.asarray, (self.words, self["pos_ids"], self["cap_lens"]))
        return compiled_apply(Evaluator(self.config), self.variables, *rows, method="embed_text")

    def movements(self, motion):
        return compiled_apply(
            Evaluator(self.config), self.variables, jnp.asarray(motion), train=False, method="movements"
        )


@pytest.fixture(scope="module", params=["nets_small", "nets_pose263"])
def golden(request, golden_dir):
    return Golden(golden_dir / "evaluation" / f"{request.param}.npz")


@pytest.fixture(scope="module")
def small(golden_dir):
    return Golden(golden_dir / "evaluation" / "nets_small.npz")


def test_embeddings_are_the_reference_s(golden):
    assert_close(golden.movements(golden["motions"]), golden["movements"])
    assert_close(golden.embed_motion(golden["motions"], golden["m_lens"]), golden["motion_emb"])
    assert_close(golden.embed_text(), golden["text_emb"])
    order = golden["sorted_align_idx"]
    assert_close(golden.embed_text()[order], golden["sorted_text_emb"])


def test_a_batch_of_every_length_end_to_end(golden_dir):
    batch = Golden(golden_dir / "evaluation" / "end_to_end.npz")
    assert_close(batch.embed_motion(batch["motions_gt"], batch["m_lens_gt"]), batch["motion_emb_gt"])
    assert_close(batch.embed_motion(batch["motions_pred"], batch["m_lens_pred"]), batch["motion_emb_pred"])
    assert_close(batch.embed_text(), batch["text_emb"])


def test_longer_arrays_change_only_the_motion_that_filled_its_own(small):
    motion = np.pad(small["motions"], ((0, 0), (0, 16), (0, 0)))
    found = small.embed_motion(motion, small["m_lens"])
    assert_close(found, small["motion_emb_padded_to_64"])
    changed = np.abs(np.asarray(found) - small["motion_emb"]).max(axis=1) > 1e-3
    np.testing.assert_array_equal(changed, small["m_lens"] == 48)
    longer = np.pad(motion, ((0, 0), (0, 16), (0, 0)))
    np.testing.assert_array_equal(small.embed_motion(longer, small["m_lens"]), found)


def test_what_lies_past_the_end_counts_as_in_the_reference(small):
    found = small.embed_motion(small["motions_dirty_padding"], small["m_lens"])
    assert_close(found, small["motion_emb_dirty_padding"])
    changed = np.abs(np.asarray(found) - small["motion_emb"]).max(axis=1) > 1e-3
    np.testing.assert_array_equal(changed, ~np.isin(small["m_lens"], (48, 39)))


def test_three_frames_past_the_end_are_seen_and_no_fourth(small):
    lengths = np.array([20], np.int32)

    def embed(motion):
        return jnp.sum(small.embed_motion(motion, lengths))

    reach = np.abs(jax.jit(jax.grad(embed))(small["motions"][:1])).max(axis=(0, 2))
    assert (reach[:23] > 0).all()
    assert (reach[23:] == 0).all()


def test_contacts_are_not_seen(small):
    motion = small["motions"].copy()
    motion[..., -4:] = 7
    np.testing.assert_array_equal(
        small.embed_motion(motion, small["m_lens"]), small.embed_motion(small["motions"], small["m_lens"])
    )


def test_words_past_the_end_are_not_seen(small):
    before = small.embed_text()
    for row, length in enumerate(small["cap_lens"]):
        small.words[row, length:] = 0
    np.testing.assert_array_equal(small.embed_text(), before)


def test_a_motion_ignores_its_neighbours_and_no_length_breaks_it(small):
    together = small.embed_motion(small["motions"], small["m_lens"])
    alone = small.embed_motion(small["motions"][2:3], small["m_lens"][2:3])
    np.testing.assert_allclose(alone, together[2:3], atol=1e-6)
    nothing = small.embed_motion(small["motions"], np.array([0, 1, 3, 0, 2, 0, 0], np.int32))
    assert np.isfinite(nothing).all()
    rounding = 1e-6 if jax.__version_info__ < (0, 10) else 0  # in JAX 0.8, rows of a batch round differently
    np.testing.assert_allclose(nothing, jnp.broadcast_to(nothing[:1], nothing.shape), rtol=0, atol=rounding)


def test_the_autoencoder_is_the_reference_s(golden_dir):
    with np.load(golden_dir / "evaluation" / "movement_autoencoder.npz") as file:
        arrays = dict(file)
    sizes = json.loads(str(arrays["config"]))
    encoder = MovementEncoder(sizes["mov_hidden"], sizes["mov_latent"], 0.2)
    decoder = MovementDecoder(sizes["dec_hidden"], sizes["dim_pose"])
    motion = jnp.asarray(arrays["motions"])

    def losses(params):
        movements = encoder.apply({"params": params["movement_enc"]}, motion[..., :-4], train=False)
        reconstruction = decoder.apply({"params": params["movement_dec"]}, movements)
        terms = movement_loss(reconstruction, motion, movements, sparsity_weight=1e-3, smoothness_weight=1e-3)
        return terms["loss"], (terms, movements, reconstruction)

    params = {part: plain_variables(arrays, part) for part in ("movement_enc", "movement_dec")}
    (_, (terms, movements, reconstruction)), gradient = jax.jit(jax.value_and_grad(losses, has_aux=True))(params)
    assert_close(movements, arrays["latents"])
    assert_close(reconstruction, arrays["recon"])
    assert_close(terms["reconstruction"], arrays["loss_rec"])
    assert_close(terms["sparsity"], arrays["loss_sparsity"])
    assert_close(terms["smoothness"], arrays["loss_smooth"])
    assert_close(terms["loss"], arrays["loss_total"])
    for part in params:
        expected = traverse_util.flatten_dict(plain_variables(arrays, f"grad/{part}"))
        assert len(expected) == 3
        found = traverse_util.flatten_dict(gradient[part])
        for path, array in expected.items():
            assert_close(found[path], array)


def test_dropout_belongs_to_the_training_of_movements(small):
    def movements(seed):
        key = {"dropout": jax.random.key(seed)}
        motion = jnp.asarray(small["motions"])
        return compiled_apply(
            Evaluator(small.config), small.variables, motion, train=True, method="movements", rngs=key
        )

    assert np.abs(movements(0) - movements(1)).max() > 0.1
    np.testing.assert_array_equal(movements(0), movements(0))


def test_the_parameter_tree():
    config = EvaluatorConfig()
    flat = traverse_util.flatten_dict(evaluator_shapes(config), sep="/")
    gru = {"backward/input/bias": (3072,), "backward/input/kernel": (1024, 3072)}
    gru |= {"backward/recurrent_bias": (3072,), "backward/recurrent_kernel": (1024, 3072)}
    gru |= {name.replace("backward", "forward"): shape for name, shape in gru.items()}
    sequence = {f"gru/{name}": shape for name, shape in gru.items()} | {"gru/initial_state": (2, 1, 1024)}
    sequence |= {"head/bias": (1024,), "head/kernel": (2048, 1024), "head_norm/bias": (1024,)}
    sequence |= {"head_norm/scale": (1024,), "input/bias": (1024,), "input/kernel": (512, 1024)}
    sequence |= {"output/bias": (512,), "output/kernel": (1024, 512)}
    movement = {"conv_0/bias": (512,), "conv_0/kernel": (4, 259, 512), "conv_1/bias": (512,)}
    movement |= {"conv_1/kernel": (4, 512, 512), "output/bias": (512,), "output/kernel": (512, 512)}
    found = {name: leaf.shape for name, leaf in flat.items()}
    for part, expected in (("motion_encoder", sequence), ("movement_encoder", movement)):
        start = f"params/{part}/"
        assert {name.removeprefix(start): shape for name, shape in found.items() if name.startswith(start)} == expected
    others = {name: shape for name, shape in found.items() if name.split("/")[1].startswith(("word", "part"))}
    assert others == {
        "params/word_embedding/embedding": (4199, 300),
        "params/part_of_speech_projection/kernel": (15, 300),
        "params/part_of_speech_projection/bias": (300,),
    }
    counts = {}
    for name, leaf in flat.items():
        counts[name.split("/")[1]] = counts.get(name.split("/")[1], 0) + leaf.size
    assert counts["movement_encoder"] == 1_842_688
    assert counts["motion_encoder"] == 15_747_584
    assert counts["text_encoder"] + counts["part_of_speech_projection"] == 4_100_288
    decoder = MovementDecoder(512, 263)
    shapes = jax.eval_shape(lambda: decoder.init(jax.random.key(0), jnp.zeros((1, 1, 512))))
    assert sum(leaf.size for leaf in jax.tree.leaves(shapes)) == 1_657_407


@pytest.mark.parametrize("field", ["feature_dim", "motion_hidden", "num_words"])
def test_sizes_that_describe_nothing_are_refused(field):
    with pytest.raises(ValueError, match=field):
        EvaluatorConfig(**{field: 0})
    with pytest.raises(ValueError, match=field):
        EvaluatorConfig(**{field: 10**9})


def test_features_that_are_contacts_alone_are_refused():
    with pytest.raises(ValueError, match="feature_dim: 4 is not more than the 4 foot contacts"):
        EvaluatorConfig(feature_dim=4)
    with pytest.raises(ValueError, match="dropout: 1"):
        EvaluatorConfig(dropout=1.0)
