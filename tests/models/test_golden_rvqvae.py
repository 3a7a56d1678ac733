"""The residual VQ-VAE of T2M-HiFiGPT against the arrays of an independent program."""

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.motions import Windows
from t2m_jax.models.system import variable_shapes
from t2m_jax.models.vqvae import RvqVaeConfig, VqVae, VqVaeOutput
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.train.optimizer import OptimizerConfig, make_optimizer
from t2m_jax.train.vqvae import VqVaeState, vqvae_losses, vqvae_train_step
from t2m_jax.train.vqvae_config import TrainRvqVaeConfig
from tests.golden_files import rvqvae_config, rvqvae_params
from tests.jit import compiled_apply

LOSSES = {name: name for name in ("reconstruction", "velocity", "acceleration", "commitment")} | {
    "bones": "bone_metres"
}


class Case:
    """A file: its arrays, our module and its variables."""

    def __init__(self, path, **options):
        self.arrays = np.load(path)
        self.sizes = json.loads(str(self.arrays["config_json"]))
        self.config = rvqvae_config(self.sizes, **options)
        self.module = VqVae(self.config)
        codebook, self.params = jnp.asarray(self.arrays["codebook"]), rvqvae_params(self.arrays)
        count = jnp.asarray(self.arrays["count"] if "count" in self.arrays else np.ones(len(codebook), np.float32))
        state = {"codebook": codebook, "ema_sum": codebook * count[:, None], "ema_count": count}
        self.codebook = {"quantizer": state | {"initialised": jnp.array(True)}}
        self.normalizer = Normalizer(self.arrays["mean"], self.arrays["std"])

    def apply(self, *arguments, **options):
        variables = {"params": self.params, "codebook": self.codebook}
        return compiled_apply(self.module, variables, *arguments, **options)


@pytest.fixture(scope="module", params=[263, pytest.param(251, marks=pytest.mark.slow)])
def case(request, golden_dir):
    return Case(golden_dir / "hifigpt" / f"rvqvae_forward_d{request.param}.npz")


def test_the_whole_network(case):
    arrays = case.arrays
    for prefix in ("", "odd/"):
        motion = jnp.asarray(arrays[f"{prefix}motion"])
        latents, _ = case.apply(motion, None, train=False, method="_latents")
        np.testing.assert_allclose(latents, arrays[f"{prefix}latents"], atol=1e-4)
        np.testing.assert_array_equal(case.apply(motion, method="encode"), arrays[f"{prefix}codes"])
        output = case.apply(motion, train=False)
        np.testing.assert_allclose(output.reconstruction, arrays[f"{prefix}reconstruction"], atol=1e-4)


@pytest.mark.slow
def test_layers_around_the_codebook(case):
    _, kept = case.apply(jnp.asarray(case.arrays["motion"]), train=False, capture_intermediates=True)
    inner = kept["intermediates"]
    np.testing.assert_allclose(inner["encoder"]["__call__"][0], case.arrays["encoder_output"], atol=1e-4)
    np.testing.assert_allclose(inner["quantizer"]["__call__"][0].quantized, case.arrays["quantized"], atol=1e-4)
    np.testing.assert_allclose(inner["project_out"]["__call__"][0], case.arrays["decoder_input"], atol=1e-4)


@pytest.mark.slow
def test_padded_motions_are_as_alone(case):
    arrays = case.arrays
    lengths, motion = arrays["ragged/lengths"], jnp.asarray(arrays["ragged/motion"])
    mask = jnp.arange(motion.shape[1])[None] < lengths[:, None]
    codes, output = case.apply(motion, mask, method="encode"), case.apply(motion, mask, train=False)
    for row, length in enumerate(lengths // 8):
        np.testing.assert_array_equal(codes[row, :length], arrays["ragged/codes"][row, :length])
        expected = arrays["ragged/reconstruction"][row, : 8 * length]
        np.testing.assert_allclose(output.reconstruction[row, : 8 * length], expected, atol=1e-4)


@pytest.mark.slow
def test_decoding_from_the_first_depths(case):
    codes = jnp.asarray(case.arrays["decode/codes"])
    for depth, expected in enumerate(case.arrays["decode/motion_by_depth"], start=1):
        motion = case.apply(codes[:, :, :depth], method="decode")
        np.testing.assert_allclose(motion, expected, atol=1e-4)


def training_config(case, **options):
    return TrainRvqVaeConfig(model=case.config, **options)


@pytest.mark.slow
def test_losses_and_gradients(case):
    arrays = case.arrays
    motion = jnp.asarray(arrays["motion"])
    windows = Windows(motion, jnp.ones(motion.shape[:2], bool))

    def total(params):
        output = case.module.apply({"params": params, "codebook": case.codebook}, motion, train=False)
        losses = vqvae_losses(output, windows, training_config(case), case.normalizer)
        return losses["loss"], (losses, output)

    (loss, (losses, output)), gradient = jax.jit(jax.value_and_grad(total, has_aux=True))(case.params)
    for ours, theirs in LOSSES.items():
        np.testing.assert_allclose(losses[ours], arrays[f"loss/{theirs}"], rtol=1e-5, atol=1e-6, err_msg=ours)
    np.testing.assert_allclose(loss, arrays["loss/total"], rtol=1e-5)
    measure = jax.jit(vqvae_losses, static_argnums=2)
    losses = measure(output, windows, training_config(case, bone_space="normalized"), case.normalizer)
    np.testing.assert_allclose(losses["bones"], arrays["loss/bone_normalized"], rtol=1e-5)
    summed = case.module.clone(config=rvqvae_config(case.sizes, commitment="sum"))
    output = compiled_apply(summed, {"params": case.params, "codebook": case.codebook}, motion, train=False)
    np.testing.assert_allclose(output.commitment_loss, arrays["loss/commitment_sum"], rtol=1e-5)

    def compare_norm(ours, theirs):
        np.testing.assert_allclose(np.linalg.norm(ours), theirs, rtol=1e-4)

    jax.tree.map(compare_norm, gradient, rvqvae_params(arrays, "grad_norm/"))
    given = rvqvae_params(arrays, "grad/")
    assert len(jax.tree.leaves(given)) > 3
    for path, theirs in jax.tree_util.tree_leaves_with_path(given):
        ours = gradient
        for key in path:
            ours = ours[key.key]
        np.testing.assert_allclose(ours, theirs, atol=2e-5 * np.abs(theirs).max())


@pytest.mark.slow
@pytest.mark.parametrize("joints", [22, 21])
@pytest.mark.parametrize("part", ["full", "ragged"])
@pytest.mark.parametrize("space", ["metres", "normalized"])
def test_losses_of_given_motion(golden_dir, joints, part, space):
    arrays = np.load(golden_dir / "hifigpt" / f"rvq_loss_j{joints}.npz")
    target, reconstruction = jnp.asarray(arrays["target"]), jnp.asarray(arrays["reconstruction"])
    lengths = arrays["lengths"] if part == "ragged" else np.full(len(target), target.shape[1])
    windows = Windows(target, jnp.arange(target.shape[1])[None] < lengths[:, None])
    config = TrainRvqVaeConfig(model=RvqVaeConfig(feature_dim=target.shape[-1]), bone_space=space)
    normalizer, nothing = Normalizer(arrays["mean"], arrays["std"]), jnp.zeros(1)

    def measure(reconstruction):
        codes = jnp.zeros((len(target), 1, 1), jnp.int32)
        output = VqVaeOutput(reconstruction, codes, jnp.zeros(()), jnp.zeros((1, 4)), nothing, nothing)
        losses = vqvae_losses(output, windows, config, normalizer)
        return losses["loss"], losses

    (_, losses), gradient = jax.jit(jax.value_and_grad(measure, has_aux=True))(reconstruction)
    expected = {name: arrays[f"{part}/{name}"] for name in ("reconstruction", "velocity", "acceleration")}
    expected |= {"bones": arrays[f"{part}/bone_{space}"], "loss": arrays[f"{part}/total_{space}"]}
    for name, value in expected.items():
        np.testing.assert_allclose(losses[name], value, rtol=1e-5, atol=1e-6, err_msg=name)
    theirs = arrays[f"{part}/grad_total_{space}"]
    np.testing.assert_allclose(gradient, theirs, atol=2e-5 * np.abs(theirs).max())


@pytest.mark.slow
def test_three_training_steps(golden_dir):
    case = Case(golden_dir / "hifigpt" / "rvqvae_train_d263.npz", reset_threshold=0.0)
    arrays, optimizer = case.arrays, OptimizerConfig(learning_rate=case.sizes["lr"], betas=tuple(case.sizes["betas"]))
    config = training_config(case, optimizer=optimizer)
    opt_state = make_optimizer(optimizer).init(case.params)
    state = VqVaeState(jnp.array(0), case.params, case.codebook, {}, opt_state)
    update = jax.jit(functools.partial(vqvae_train_step, config=config, normalizer=case.normalizer))
    encode = jax.jit(functools.partial(case.module.apply, method="encode"))
    for step, motion in enumerate(arrays["motion"]):
        windows = Windows(jnp.asarray(motion), jnp.ones(motion.shape[:2], bool))
        codes = encode(state.variables, windows.motion)
        np.testing.assert_array_equal(codes, arrays["codes"][step])
        state, metrics = update(state, windows, jax.random.key(step))
        for ours, theirs in (LOSSES | {"loss": "total"}).items():
            np.testing.assert_allclose(metrics[ours], arrays[f"loss/{theirs}"][step], rtol=1e-4, err_msg=ours)
        moved = state.codebook["quantizer"]
        for ours, theirs in (("codebook", "codebook"), ("ema_count", "count"), ("ema_sum", "sum")):
            np.testing.assert_allclose(moved[ours], arrays[f"{theirs}_after"][step], rtol=1e-4, atol=1e-4)
    assert_final_weights(state.params, rvqvae_params(arrays, "final/"))


def assert_final_weights(ours, theirs):
    errors = np.concatenate([np.abs(a - b).ravel() for a, b in zip(*map(jax.tree.leaves, (ours, theirs)), strict=True)])
    assert np.quantile(errors, 0.999) < 1e-5
    assert errors.max() < 2e-3


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("rvqvae_humanml3d", {}),
        ("rvqvae_kit", {"feature_dim": 251}),
        ("rvqvae_humanml3d_no_projections", {"projections": False}),
        ("depth3_no_projections", {"projections": False, "depth": 3}),
        ("t2m_gpt_vqvae", {"projections": False, "depth": 3, "num_stages": 2, "num_codes": 512, "num_quantizers": 1}),
    ],
)
def test_parameter_counts(golden_dir, name, options):
    counts = json.loads((golden_dir / "hifigpt" / "parameter_counts.json").read_text())[name]
    shapes = variable_shapes(RvqVaeConfig(**options))
    parts = {part: sum(leaf.size for leaf in jax.tree.leaves(tree)) for part, tree in shapes["params"].items()}
    assert sum(parts.values()) == counts["trained"]
    parts["codebook"] = shapes["codebook"]["quantizer"]["codebook"].size
    assert parts | {"trained": counts["trained"], "total": sum(parts.values())} == counts
