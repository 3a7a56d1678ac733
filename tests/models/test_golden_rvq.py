"""Residual quantization against the arrays of an independent program."""

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.models.codebook import CodebookState
from t2m_jax.models.quantizer import Quantizer, look_up

CLOSE = {"rtol": 1e-5, "atol": 1e-5}


def load(golden_dir, name):
    return np.load(golden_dir / "hifigpt" / f"{name}.npz")


def make_quantizer(arrays, **options):
    sizes = json.loads(str(arrays["config_json"]))
    decay, threshold = sizes.get("ema_decay", 0.99), sizes.get("reset_threshold", 1.0)
    options = {"codebook_update": sizes.get("codebook_update", "joint"), "num_quantizers": sizes["depth"]} | options
    return Quantizer(sizes["num_codes"], sizes["code_dim"], "ema_redraw", decay, threshold, **options)


def collection(codebook, count=None, total=None):
    count = np.ones(len(codebook), np.float32) if count is None else count
    total = codebook * count[:, None] if total is None else total
    state = CodebookState(jnp.asarray(codebook), jnp.asarray(total), jnp.asarray(count), jnp.array(True))
    return {"codebook": state._asdict()}


@functools.partial(jax.jit, static_argnames="module")
def _step(variables, latents, mask, *, module):
    streams = {"codebook": jax.random.key(3)}
    return module.apply(variables, latents, mask, train=True, rngs=streams, mutable=["codebook"])


def step(module, variables, latents, mask):
    """Returns the output and the state after a training step on one row of latents."""
    output, moved = _step(variables, jnp.asarray(latents)[None], jnp.asarray(mask, bool)[None], module=module)
    return output, jax.tree.map(np.asarray, moved["codebook"])


def test_ties_go_to_the_lowest_code(golden_dir):
    arrays = load(golden_dir, "rvq_lookup_ties")
    assert (arrays["num_nearest"] > 1).any()
    state = CodebookState(jnp.asarray(arrays["codebook"]), *[jnp.zeros(())] * 3)
    found, _ = look_up(jnp.asarray(arrays["latents"]), state, jnp.ones(arrays["codes"].shape[1], bool))
    np.testing.assert_array_equal(found.codes.T, arrays["codes"])


@pytest.mark.parametrize("name", ["r6", *(pytest.param(name, marks=pytest.mark.slow) for name in ("r1", "r3", "r10"))])
def test_lookup(golden_dir, name):
    arrays = load(golden_dir, f"rvq_lookup_{name}")
    module, mask = make_quantizer(arrays), arrays["mask"] == 1
    latents, depth = jnp.asarray(arrays["latents"]), arrays["codes"].shape[1]
    state = CodebookState(jnp.asarray(arrays["codebook"]), *[jnp.zeros(())] * 3)
    found, _ = look_up(latents, state, jnp.ones(depth, bool))
    np.testing.assert_array_equal(found.codes.T[mask], arrays["codes"][mask])
    np.testing.assert_allclose(np.swapaxes(found.residuals, 0, 1)[mask], arrays["residuals"][mask], **CLOSE)
    np.testing.assert_allclose(np.swapaxes(found.totals, 0, 1)[mask], arrays["partial_sums"][mask], **CLOSE)
    variables = collection(arrays["codebook"])
    for kind in ("mean", "sum"):
        quantizer = module.clone(commitment=kind)
        output = quantizer.apply(variables, latents[None], jnp.asarray(mask)[None], train=False)
        np.testing.assert_allclose(output.commitment_loss, arrays[f"commitment_{kind}"], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(output.quantized[0][mask], arrays["quantized"][mask], **CLOSE)
    np.testing.assert_array_equal(output.code_counts, arrays["hits"])


def assert_drawn(codes, pool):
    """Every code is a vector of the pool; none comes more often than there, if there are enough."""
    pool = pool.reshape(-1, pool.shape[-1])
    pool = pool[np.any(pool != 0, axis=1)]
    distance = np.abs(pool[None] - codes[:, None]).max(axis=2)
    np.testing.assert_allclose(distance.min(axis=1), 0, atol=1e-5)
    same_codes = np.abs(codes[None] - codes[:, None]).max(axis=2) < 1e-5
    if len(codes) <= len(pool):
        assert (same_codes.sum(axis=1) <= (distance < 1e-5).sum(axis=1)).all()


def assert_state(moved, arrays, number, *, pool):
    """Alive codes are the reference's; dead ones are vectors that were looked up."""
    dead = arrays["dead"][number] == 1
    for ours, theirs in (("codebook", "codebook_after"), ("ema_count", "count_after"), ("ema_sum", "sum_after")):
        np.testing.assert_allclose(moved[ours][~dead], arrays[theirs][number][~dead], **CLOSE)
    np.testing.assert_array_equal(moved["ema_count"][dead], 1)
    np.testing.assert_array_equal(moved["ema_sum"][dead], moved["codebook"][dead])
    assert_drawn(moved["codebook"][dead], pool)


@pytest.mark.parametrize(
    "name",
    [
        "joint_decay0.9",
        pytest.param("joint_decay0.99", marks=pytest.mark.slow),
        "joint_no_reset",
        "per_depth_decay0.99",
    ],
)
def test_codebook_updates(golden_dir, name):
    arrays = load(golden_dir, f"rvq_ema_{name}")
    module, per_depth = make_quantizer(arrays), name.startswith("per_depth")
    for number, latents in enumerate(arrays["latents"]):
        before = [arrays[f"{part}_before"][number] for part in ("codebook", "count", "sum")]
        mask = arrays["mask"][number] == 1
        output, moved = step(module, collection(*before), latents, mask)
        np.testing.assert_array_equal(output.codes[0][mask], arrays["codes"][number][mask])
        residuals = arrays["residuals"][number][mask]
        assert_state(moved, arrays, number, pool=residuals[:, -1] if per_depth else residuals)
        assert output.expired.sum() == arrays["dead"][number].sum()
        if not per_depth:
            np.testing.assert_array_equal(output.code_counts, arrays["hits"][number])
            continue
        np.testing.assert_allclose(output.quantized[0][mask], arrays["quantized"][number][mask], **CLOSE)
        for depth in range(module.num_quantizers - 1):
            _, earlier = step(module.clone(num_quantizers=depth + 1), collection(*before), latents, mask)
            np.testing.assert_allclose(earlier["codebook"], arrays["codebook_by_depth"][number, depth], **CLOSE)
            np.testing.assert_allclose(earlier["ema_count"], arrays["count_by_depth"][number, depth], **CLOSE)


@pytest.mark.parametrize("name", ["first_batch", "first_batch_few_rows"])
def test_first_codebook(golden_dir, name):
    arrays = load(golden_dir, f"rvq_ema_{name}")
    module, mask = make_quantizer(arrays), arrays["mask"] == 1
    zeros = np.zeros_like(arrays["provisional_codebook"])
    variables = collection(zeros)
    variables["codebook"]["initialised"] = jnp.array(False)
    # With a decay of 1 the first codebook stays as it is.
    _, moved = step(module.clone(ema_decay=1.0, reset_threshold=0.0), variables, arrays["latents"], mask)
    assert_drawn(moved["codebook"], arrays["pool"][mask])
    np.testing.assert_array_equal(moved["ema_count"], 1)


def test_update_of_the_first_batch(golden_dir):
    arrays = load(golden_dir, "rvq_ema_first_batch")
    module, mask = make_quantizer(arrays), arrays["mask"] == 1
    output, moved = step(module, collection(arrays["first_codebook"]), arrays["latents"], mask)
    np.testing.assert_array_equal(output.codes[0][mask], arrays["codes"][mask])
    after = {name: arrays[name][None] for name in ("dead", "codebook_after", "count_after", "sum_after")}
    assert_state(moved, after, 0, pool=arrays["residuals"][mask])


@pytest.mark.slow
def test_commitment_and_its_gradients(golden_dir):
    arrays = load(golden_dir, "rvq_loss_commitment")
    module = make_quantizer(arrays)
    latents, probe = jnp.asarray(arrays["latents"]), jnp.asarray(arrays["probe"])
    mask = jnp.arange(latents.shape[1])[None] < arrays["lengths"][:, None]
    variables = collection(arrays["codebook"])

    def loss(latents, kind):
        output = module.clone(commitment=kind).apply(variables, latents, mask, train=False)
        return output.commitment_loss, output

    for kind in ("mean", "sum"):
        (value, output), gradient = jax.value_and_grad(loss, has_aux=True)(latents, kind)
        np.testing.assert_allclose(value, arrays[kind], rtol=1e-5, atol=1e-6)
        expected = arrays[f"grad_{kind}"]
        np.testing.assert_allclose(gradient, expected, atol=2e-5 * np.abs(expected).max())
    np.testing.assert_array_equal(np.where(mask[:, :, None], output.codes, -1), arrays["codes"])

    def probed(latents):
        value, output = loss(latents, "mean")
        return 0.02 * value + jnp.sum(output.quantized * probe)

    expected = arrays["grad_probe"]
    np.testing.assert_allclose(jax.grad(probed)(latents), expected, atol=2e-5 * np.abs(expected).max())
