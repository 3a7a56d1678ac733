"""What users meet who give an array of a wrong shape: one clear error, also where such a shape would broadcast."""

import dataclasses

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from t2m_jax import losses
from t2m_jax.masks import mask_from_lengths, masked_mean
from t2m_jax.models.caption_encoder import CaptionEncoder
from t2m_jax.models.evaluator import Evaluator, evaluator_shapes
from t2m_jax.models.hifigpt import HiFiGpt
from t2m_jax.models.motion_gpt import MotionGpt
from t2m_jax.models.system import variable_shapes
from t2m_jax.models.vqvae import VqVae
from t2m_jax.motion.skeleton import HUMANML3D
from tests.jit import compiled_apply
from tests.tiny import CAPTION_ENCODER, EVALUATOR, GPT, HIFIGPT, RVQVAE, VQVAE, walking_normalizer


@pytest.fixture(autouse=True)
def unchecked(monkeypatch):
    """Turns the shape checks of test runs off."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


def numbers(*shape):
    return np.zeros(shape, np.float32)


def whole(*shape):
    return np.zeros(shape, np.int32)


def data(*shape):
    return np.ones(shape, bool)


CAPTIONS = (CaptionEncoder(CAPTION_ENCODER), lambda: captions_shapes())
MODULES = {
    "vqvae": (VqVae(VQVAE), lambda: variable_shapes(VQVAE)),
    "rvqvae": (VqVae(RVQVAE), lambda: variable_shapes(RVQVAE)),
    "gpt": (MotionGpt(GPT), lambda: variable_shapes(GPT)),
    "hifigpt": (HiFiGpt(HIFIGPT), lambda: variable_shapes(HIFIGPT)),
    "evaluator": (Evaluator(EVALUATOR), lambda: evaluator_shapes(EVALUATOR)),
    "captions": CAPTIONS,
}


def captions_shapes():
    module = CaptionEncoder(CAPTION_ENCODER)
    return jax.eval_shape(lambda: module.init(jax.random.key(0), whole(1, 4), data(1, 4), train=False))


def refused(function, *arguments, **options):
    with pytest.raises(AssertionError, match=r"^\[Chex\]"):
        jax.eval_shape(lambda: function(*arguments, **options))


@pytest.mark.parametrize(
    ("name", "method", "arguments"),
    [
        ("vqvae", "encode", (numbers(2, 16, 262),)),
        ("vqvae", "encode", (numbers(16, 263),)),
        ("vqvae", "encode", (numbers(2, 16, 263), data(1, 16))),
        ("vqvae", "decode", (whole(4),)),
        ("vqvae", "decode", (whole(2, 4, 2),)),
        ("vqvae", "decode", (whole(2, 4, 1), data(1, 4))),
        ("vqvae", "decode_latents", (numbers(2, 4, 7),)),
        ("rvqvae", "decode", (whole(2, 4),)),
        ("gpt", "begin", (numbers(2, 11),)),
        ("gpt", "begin", (numbers(12),)),
        ("gpt", "log_likelihood", (whole(2, 4, 1), numbers(1, 12))),
        ("hifigpt", "begin", (numbers(2, 11),)),
        ("hifigpt", "log_likelihood", (whole(2, 4, 2), numbers(2, 12))),
        ("hifigpt", "log_likelihood", (whole(2, 4, 3), numbers(1, 12))),
        ("evaluator", "embed_motion", (numbers(2, 16, 262), whole(2))),
        ("evaluator", "embed_motion", (numbers(2, 16, 263), whole(1))),
        ("evaluator", "embed_text", (whole(2, 5), whole(1, 5), whole(2))),
    ],
)
def test_modules_refuse_wrong_shapes(name, method, arguments):
    module, shapes = MODULES[name]
    variables = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes())
    refused(module.apply, variables, *arguments, method=method)


def test_a_caption_encoder_refuses_another_mask():
    module, shapes = CAPTIONS
    variables = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes())
    refused(module.apply, variables, whole(2, 4), data(1, 4), train=False)


MOTION = numbers(2, 16, 263)
ONE = numbers(1, 16, 263)
MASK = data(2, 16)
IN_METERS = {"skeleton": HUMANML3D, "normalizer": walking_normalizer()}
KIND = {"kind": "l2"}
VELOCITY = KIND | {"velocity": "frame_difference", "positions": HUMANML3D.layout.positions}


@pytest.mark.parametrize(
    ("loss", "options"),
    [
        (losses.reconstruction_loss, KIND),
        (losses.velocity_loss, VELOCITY),
        (losses.acceleration_loss, KIND),
        (losses.bone_loss, IN_METERS),
        (losses.joint_loss, IN_METERS),
        (losses.facing_loss, IN_METERS),
        (losses.world_loss, IN_METERS | {"order": 1}),
        (losses.world_loss, IN_METERS | {"order": 2}),
    ],
)
def test_losses_of_motion_refuse_what_would_broadcast(loss, options):
    for arguments in ((ONE, MOTION, MASK), (MOTION, ONE, MASK), (MOTION, MOTION, data(1, 16))):
        refused(loss, *arguments, **options)


@pytest.mark.parametrize(
    ("loss", "arguments", "options"),
    [
        (losses.mean_weights, (whole(2, 1), 4), {}),
        (losses.token_loss, (numbers(2, 5, 9), whole(2, 5), numbers(1, 5)), {}),
        (losses.token_loss, (numbers(2, 5, 9), whole(1, 5), numbers(2, 5)), {}),
        (losses.token_accuracy, (numbers(2, 5, 9), whole(2, 1), numbers(2, 5)), {}),
        (losses.stop_loss, (numbers(2, 5), data(1, 5), numbers(2, 5)), {}),
        (losses.movement_loss, (ONE, MOTION, numbers(2, 4, 7)), {"sparsity_weight": 1.0, "smoothness_weight": 1.0}),
        (losses.pair_distances, (numbers(4, 8), numbers(1, 8)), {}),
        (losses.margin_loss, (numbers(4, 8), numbers(1, 8), 1), {"margin": 1.0}),
        (losses.infonce_loss, (numbers(4, 8), numbers(4, 8), data(1, 4)), {"temperature": 1.0}),
        (losses.infonce_loss, (numbers(4, 8), numbers(5, 8), data(4, 4)), {"temperature": 1.0}),
        (mask_from_lengths, (whole(2, 1), 4), {}),
        (masked_mean, (numbers(2, 5, 9), data(2, 4, 1)), {}),
    ],
)
def test_losses_of_tokens_and_embeddings_refuse_what_would_broadcast(loss, arguments, options):
    refused(loss, *arguments, **options)


@pytest.mark.slow
def test_right_shapes_are_taken():
    motion = np.zeros((2, 16, 263), np.float32)
    variables = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), variable_shapes(VQVAE))
    codes = compiled_apply(VqVae(VQVAE), variables, motion, MASK, method="encode")
    assert codes.shape == (2, 4, 1)
    for given in (codes, codes[:, :, 0]):
        assert compiled_apply(VqVae(VQVAE), variables, given, method="decode").shape == motion.shape
    coarse = dataclasses.replace(RVQVAE, num_quantizers=3)
    variables = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), variable_shapes(coarse))
    assert compiled_apply(VqVae(coarse), variables, whole(2, 2, 1), method="decode").shape == motion.shape
