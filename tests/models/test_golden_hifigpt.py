"""The double-tier GPT of T2M-HiFiGPT against the arrays of an independent program."""

import dataclasses
import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from t2m_jax.data.banks.codes import CodeBatch
from t2m_jax.models.hifigpt import HiFiGpt, HiFiGptConfig, guided
from t2m_jax.models.projection import transpose_kernels
from t2m_jax.models.system import variable_shapes
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.programs import generate_codes
from t2m_jax.sampling.stopping import make_stop_rule
from t2m_jax.sampling.strategies import Greedy
from t2m_jax.train.hifigpt import HiFiGptState, TrainHiFiGptConfig, hifigpt_metrics, hifigpt_train_step
from t2m_jax.train.hifigpt import make_hifigpt_batch as make_batch
from t2m_jax.train.optimizer import OptimizerConfig, make_optimizer
from tests.golden_files import hifigpt_config, hifigpt_params
from tests.jit import compiled_apply
from tests.models.test_golden_rvqvae import assert_final_weights

CASES = (
    *("default", "cumulative_depth", "corrupted"),
    *(pytest.param(case, marks=pytest.mark.slow) for case in ("frozen", "learned", "per_depth", "corrupt_residual")),
)


def load(golden_dir, name):
    return np.load(golden_dir / "hifigpt" / f"hifigpt_{name}.npz")


def make_model(arrays, case=""):
    """Returns the module, its variables and the sizes of a case."""
    sizes = json.loads(str(arrays[f"{case}/config_json" if case else "config_json"]))
    config = hifigpt_config(sizes)
    variables = {"params": hifigpt_params(arrays, config=config)}
    if config.code_embedding != "learned":
        variables["codebook"] = {"codebook": jnp.asarray(arrays["weights/codebook"])}
    return HiFiGpt(config), variables, sizes


def assert_rows(found, expected, lengths, *, atol=5e-5):
    """The predictions of data rows are equal."""
    for row, length in enumerate(lengths):
        np.testing.assert_allclose(found.code_logits[row, :length], expected[0][row, :length], atol=atol)
        np.testing.assert_allclose(found.stop_logits[row, :length], expected[1][row, :length], atol=atol)


@pytest.mark.parametrize("case", CASES)
def test_forward(golden_dir, case):
    arrays = load(golden_dir, "forward")
    module, variables, sizes = make_model(arrays, case)
    clean, text = jnp.asarray(arrays["codes"]), jnp.asarray(arrays["text"])
    read = jnp.asarray(arrays["corrupted_codes"]) if case.startswith("corrupt") else clean
    output = compiled_apply(module, variables, read, text, read if sizes["corrupt_residual"] else clean, train=False)
    expected = [arrays[f"{case}/{part}_logits"] for part in ("code", "stop")]
    assert_rows(output, expected, arrays["code_lengths"])


def test_contexts_and_no_text(golden_dir):
    arrays = load(golden_dir, "forward")
    module, variables, _ = make_model(arrays, "default")
    codes, text = jnp.asarray(arrays["codes"]), jnp.asarray(arrays["text"])
    contexts = compiled_apply(module, variables, codes, text, train=False, method="contexts")
    for row, length in enumerate(arrays["code_lengths"]):
        expected = arrays["default/contexts"][row, : length + 1]
        np.testing.assert_allclose(contexts[row, : length + 1], expected, atol=5e-5)
    output = compiled_apply(module, variables, codes, jnp.zeros_like(text), train=False)
    assert_rows(output, [arrays[f"zero_text/{part}_logits"] for part in ("code", "stop")], arrays["code_lengths"])


def test_what_a_code_changes(golden_dir):
    """Changing a code changes no logit before it, of its own depth, of earlier depths, nor earlier stops."""
    arrays = load(golden_dir, "forward")
    module, variables, _ = make_model(arrays, "default")
    text = jnp.asarray(arrays["text"])
    before = compiled_apply(module, variables, jnp.asarray(arrays["codes"]), text, train=False)
    after = compiled_apply(module, variables, jnp.asarray(arrays["altered/codes"]), text, train=False)
    for name in ("code_logits", "stop_logits"):
        unchanged = arrays[f"altered/{name}_unchanged"] == 1
        length = arrays["code_lengths"][0]
        same = np.isclose(getattr(before, name)[0], getattr(after, name)[0], atol=1e-6)
        same = same.reshape(*unchanged.shape, -1).all(axis=-1)
        np.testing.assert_array_equal(same[:length], unchanged[:length])


class LossCase:
    """A file with losses: our config, variables, and the batch of a step."""

    def __init__(self, arrays, case="", **options):
        self.arrays = arrays
        module, self.variables, sizes = make_model(arrays, case)
        self.sizes = sizes
        options |= {name: sizes[name] for name in ("corrupt_residual", "stop_weight", "stop_positive_weight")}
        self.config = TrainHiFiGptConfig(model=module.config, text_encoder="clip", **options)
        self.params = {"hifigpt": self.variables["params"]}
        self.codebook = {"hifigpt": self.variables["codebook"]}

    def batch(self, step=None):
        def get(name):
            return jnp.asarray(self.arrays[name] if step is None else self.arrays[name][step])

        codes = get("codes")
        inputs = jnp.where(get("corrupted_rows")[:, :, None] == 1, get("replacement_codes"), codes)
        given = CodeBatch(codes, get("code_lengths"), get("text"))
        return make_batch(given, config=self.config, inputs=inputs, dropped=get("text_dropped") == 1)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["default", "corrupt_residual", "stop_weights"])
@pytest.mark.parametrize("mean_over", ["tokens", "motions"])
def test_losses(golden_dir, case, mean_over):
    arrays = load(golden_dir, "loss")
    setup = LossCase(arrays, case, mean_over=mean_over)
    measure = jax.jit(functools.partial(hifigpt_metrics, config=setup.config))
    metrics = measure(setup.params, setup.codebook, setup.batch())
    suffix = "_mean_over_motions" if mean_over == "motions" else ""
    for name in ("nll", "stop", "loss"):
        expected = arrays[f"{case}/{name}{suffix}"]
        np.testing.assert_allclose(metrics[name], expected, rtol=1e-5, atol=1e-6, err_msg=name)
    depths = [metrics[f"nll/{w + 1}"] for w in range(setup.config.model.num_quantizers)]
    if mean_over == "tokens":
        per_code = arrays[f"{case}/nll_per_code"][arrays["mask"] == 1]
        np.testing.assert_allclose(depths, per_code.mean(axis=0), rtol=1e-5)


@pytest.mark.slow
def test_gradients(golden_dir):
    arrays = load(golden_dir, "loss")
    setup = LossCase(arrays, "default")
    batch = setup.batch()

    def loss(params):
        return hifigpt_metrics(params, setup.codebook, batch, config=setup.config)["loss"]

    gradient = jax.jit(jax.grad(loss))(setup.params)["hifigpt"]
    for prefix, compare in (("grad/", compare_arrays), ("grad_norm/", compare_norms)):
        expected = hifigpt_params(arrays, prefix)
        assert len(jax.tree.leaves(expected)) > 3
        for path, theirs in jax.tree_util.tree_leaves_with_path(expected):
            ours = gradient
            for key in path:
                ours = ours[key.key]
            compare(ours, theirs)


def compare_arrays(ours, theirs):
    np.testing.assert_allclose(ours, theirs, atol=2e-5 * np.abs(theirs).max())


def compare_norms(ours, theirs):
    np.testing.assert_allclose(np.linalg.norm(ours), theirs, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("num_parts", [1, 5])
def test_three_training_steps(golden_dir, num_parts):
    arrays = load(golden_dir, "train")
    sizes = json.loads(str(arrays["config_json"]))
    optimizer = OptimizerConfig(
        learning_rate=sizes["lr"],
        betas=tuple(sizes["betas"]),
        weight_decay=sizes["weight_decay"],
        clip_norm=sizes["clip"],
    )
    setup = LossCase(arrays, optimizer=optimizer)
    # The loop's batch size is not used here, but the parts must divide it.
    loop = dataclasses.replace(setup.config.loop, batch_size=5)
    config = dataclasses.replace(setup.config, num_parts=num_parts, loop=loop)
    params = jax.tree.map(jnp.asarray, setup.params)
    state = HiFiGptState(jnp.array(0), params, setup.codebook, make_optimizer(optimizer).init(params))
    update = jax.jit(functools.partial(hifigpt_train_step, config=config))
    for step in range(3):
        state, metrics = update(state, setup.batch(step))
        for name in ("nll", "stop", "loss"):
            np.testing.assert_allclose(metrics[name], arrays[name][step], rtol=1e-4, err_msg=name)
    expected = hifigpt_params(arrays, "final/")
    ours = dict(jax.tree_util.tree_leaves_with_path(state.params["hifigpt"]))
    theirs = dict(jax.tree_util.tree_leaves_with_path(expected))
    assert len(theirs) > len(ours) - 5, "only the biases of keys are left out"
    assert_final_weights([ours[path] for path in theirs], list(theirs.values()))
    np.testing.assert_array_equal(state.codebook["hifigpt"]["codebook"], arrays["weights/codebook"])


@pytest.mark.parametrize(
    ("scale", "is_transposed"),
    [(4, True), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((1, False), (1, True), (4, False)))],
)
def test_greedy_sampling(golden_dir, scale, is_transposed):
    arrays = load(golden_dir, "sample")
    module, variables, _ = make_model(arrays)
    if is_transposed:
        variables = transpose_kernels(variables, module.config)
    text, keys = jnp.asarray(arrays["text"]), jax.random.split(jax.random.key(0), len(arrays["text"]))
    group = f"guidance{scale}/"
    for rule in ("argmax", "threshold"):
        sampling = Sampling(Greedy(), make_stop_rule(rule), module.config.max_codes)
        for given in [None, jnp.float32(1.0)] if scale == 1 else [jnp.float32(scale)]:
            sampled = generate_codes(variables, text, keys, given, generator=module, sampling=sampling)
            lengths = arrays[f"{group}length_{rule}"]
            np.testing.assert_array_equal(sampled.code_lengths, lengths)
            kept = np.arange(sampled.codes.shape[1])[None] < lengths[:, None]
            np.testing.assert_array_equal(sampled.codes[kept], arrays[f"{group}codes"][kept])


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1, 4])
def test_cached_steps_equal_the_whole_sequence(golden_dir, scale):
    """The stop logits of single steps are those of the reference, which reads all rows at once; so are the codes'."""
    arrays = load(golden_dir, "sample")
    module, variables, _ = make_model(arrays)
    text, codes = jnp.asarray(arrays["text"]), jnp.asarray(arrays[f"guidance{scale}/codes"])

    def read(model):
        _, cache = model.begin(text, jnp.float32(scale))
        scores = []
        for row in range(codes.shape[1]):
            _, score, cache = model.step(cache, codes[:, row])
            scores.append(score)
        return jnp.stack(scores, axis=1)

    expected = arrays[f"guidance{scale}/stop_logits"]
    found = jax.jit(functools.partial(module.apply, method=read))(variables)
    np.testing.assert_allclose(found, expected, atol=2e-4)
    with_text, without = (
        compiled_apply(module, variables, codes, given, train=False) for given in (text, jnp.zeros_like(text))
    )
    halves = jnp.stack([output.code_logits.reshape(len(text), -1) for output in (with_text, without)], axis=1)
    found = guided(halves, jnp.full(len(text), float(scale))).reshape(with_text.code_logits.shape)
    np.testing.assert_allclose(found, arrays[f"guidance{scale}/code_logits"], atol=2e-4)


@pytest.mark.parametrize("embedding", ["projected", "frozen", "learned"])
@pytest.mark.parametrize("head", ["shared", "per_depth"])
def test_parameter_counts(golden_dir, embedding, head):
    counts = json.loads((golden_dir / "hifigpt" / "parameter_counts.json").read_text())[f"hifigpt_{embedding}_{head}"]
    shapes = variable_shapes(HiFiGptConfig(code_embedding=embedding, head=head))
    trained, total = (sum(leaf.size for leaf in jax.tree.leaves(tree)) for tree in (shapes["params"], shapes))
    assert (trained, total) == (counts["trained"], counts["total"])
