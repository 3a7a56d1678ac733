"""Arguments for every jitted function of the package, and for every update that trainers have the program compile.

`test_compiled.py` compares their results with and without jit.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from t2m_jax.data import make_motion
from t2m_jax.data.banks.captions import CaptionBank, make_caption_bank
from t2m_jax.data.banks.codes import CodeBank
from t2m_jax.data.banks.motions import MotionBank, make_bank
from t2m_jax.data.folder import Clip
from t2m_jax.data.texts import Caption
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.caption_encoder import CaptionEncoder, StateEncoder, StateEncoderConfig, init_network
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig, evaluator_shapes
from t2m_jax.models.sentence_encoder import SentenceEncoder, SentenceEncoderConfig
from t2m_jax.models.system import make_module, variable_shapes
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.motion.targets import read_target
from t2m_jax.sampling.directing import Attempt, make_goals
from t2m_jax.sampling.loop import Sampling
from t2m_jax.sampling.programs import begin_motions, begin_slots
from t2m_jax.sampling.stopping import StopAtEnd, StopAtThreshold
from t2m_jax.sampling.strategies import Temperature
from t2m_jax.text.bpe import CaptionTokens
from t2m_jax.text.caption_states import StateTable
from t2m_jax.text.word_vectors import Vocabulary
from t2m_jax.train import LoopConfig, OptimizerConfig, TrainVqVaeConfig
from t2m_jax.train.evaluator import init_matching_state
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.gpt import TrainGptConfig, init_gpt_state
from t2m_jax.train.hifigpt import TrainHiFiGptConfig, init_hifigpt_state
from t2m_jax.train.movement import init_movement_state
from t2m_jax.train.optimizer import first_state
from t2m_jax.train.teaching import TeachingConfig
from t2m_jax.train.vqvae import init_vqvae_state
from tests.tiny import CAPTION_ENCODER, GPT, VQVAE, random_variables, walking_normalizer
from tests.tiny import HIFIGPT as TINY_HIFIGPT

CASES: dict[str, Callable[[], "Case"]] = {}
"""By `module.function`, without `t2m_jax.`; after a colon, what it is called for."""


class Case(NamedTuple):
    """Arguments of a function, and how far two results may be apart."""

    arguments: tuple
    options: dict[str, Any]
    rtol: float = 1e-5
    atol: float = 1e-6
    mesh: Mesh | None = None
    """The devices that the function needs around it."""


def case(name: str) -> Callable:
    """Registers a function that makes a case."""

    def register(make: Callable[[], Case]) -> Callable[[], Case]:
        CASES[name] = make
        return make

    return register


# Without jit every operation is compiled for every shape: few layers, and widths that agree.
TOKENIZER = dataclasses.replace(VQVAE, num_stages=1, code_dim=16)
GENERATOR = dataclasses.replace(GPT, num_layers=1, text_dim=16, block_size=9)
HIFIGPT = dataclasses.replace(
    TINY_HIFIGPT, num_layers=1, num_residual_layers=1, text_dim=16, code_dim=16, max_codes=8, num_quantizers=2
)
TEXT_ENCODER = dataclasses.replace(CAPTION_ENCODER, text_dim=16, max_length=8)
STATE_ENCODER = StateEncoderConfig(state_dim=16, max_length=8, embed_dim=16, num_layers=1, num_heads=2, text_dim=16)
CLIP = ClipTextConfig(
    vocabulary_size=20, max_length=6, embed_dim=16, num_layers=1, num_heads=2, mlp_dim=32, text_dim=16
)
# Adam's first update is the learning rate times the sign of the gradient. If that is rounding, two results differ by
# twice the rate, so the rate is below the tolerance; the gradients themselves are compared as Adam's moments.
OPTIMIZER = OptimizerConfig(learning_rate=1e-7)
LOOP = LoopConfig(num_steps=8, batch_size=2, seed=5)
VQVAE_TRAINING = TrainVqVaeConfig(model=TOKENIZER, window=16, optimizer=OPTIMIZER, loop=LOOP)
GPT_TRAINING = TrainGptConfig(model=GENERATOR, caption_encoder=TEXT_ENCODER, optimizer=OPTIMIZER, loop=LOOP)
HIFIGPT_TRAINING = TrainHiFiGptConfig(model=HIFIGPT, caption_encoder=TEXT_ENCODER, optimizer=OPTIMIZER, loop=LOOP)
STANDARD_NORMAL = Normalizer(np.zeros(263, np.float32), np.ones(263, np.float32))
"""The statistics of `clips`."""
WORDS = Vocabulary(("sos", "eos", "unk", "walk", "wave"))
EVALUATOR_TRAINING = TrainEvaluatorConfig(
    model=EvaluatorConfig(
        movement_hidden=8,
        movement_dim=8,
        motion_hidden=8,
        text_hidden=8,
        embedding_dim=8,
        word_dim=8,
        num_words=len(WORDS),
    ),
    decoder_hidden=8,
    window=16,
    movement_batch_size=2,
    movement_optimizer=OPTIMIZER,
    optimizer=OPTIMIZER,
    loop=LOOP,
)
TRAINING_TOLERANCE = {"rtol": 1e-4, "atol": 2e-6}


def normal(seed: int, *shape: int) -> jax.Array:
    """Returns standard normal numbers."""
    return jax.random.normal(jax.random.key(seed), shape)


def on_device(normalizer: Normalizer) -> Normalizer:
    """Returns statistics as device arrays."""
    return Normalizer(*map(jnp.asarray, normalizer))


def first_steps() -> jax.Array:
    """Returns the number of a step."""
    return jnp.array(3, jnp.int32)


def weights(shapes: Any) -> Any:
    """Returns random weights on the device."""
    return jax.device_put(random_variables(shapes, gain=1.0))


@functools.cache
def tokenizer_variables() -> Any:
    """Returns random weights of the tokenizer."""
    return weights(variable_shapes(TOKENIZER))


def codes_and_lengths() -> tuple[jax.Array, jax.Array]:
    """Returns codes of two motions."""
    return jnp.array([[[3], [1], [7]], [[2], [0], [0]]], jnp.int32), jnp.array([3, 1], jnp.int32)


def clips() -> list[Clip]:
    """Returns three motions of noise, with captions."""
    generator = np.random.default_rng(0)
    captions = (Caption("walk", ("walk/VERB",)), Caption("wave", ("wave/VERB",)))
    lengths = (20, 33, 17)
    return [
        Clip(f"{length}", generator.normal(size=(length, 263)).astype(np.float32), captions[: 1 + length % 2])
        for length in lengths
    ]


def motion_bank() -> MotionBank:
    """Returns the motions on the device."""
    return jax.device_put(make_bank(clips(), STANDARD_NORMAL))


def caption_bank() -> CaptionBank:
    """Returns motions and captions on the device."""
    return jax.device_put(make_caption_bank(clips(), STANDARD_NORMAL, WORDS))


def code_bank(num_quantizers: int = 1) -> CodeBank:
    """Returns three motions as codes, from two offsets, with a caption each."""
    codes = jax.random.randint(jax.random.key(2), (3, 2, 6, num_quantizers), 0, GENERATOR.num_codes)
    tokens = jax.random.randint(jax.random.key(3), (3, TEXT_ENCODER.max_length), 2, 90)
    captions = CaptionTokens(tokens, mask_from_lengths(jnp.array([4, 8, 6]), TEXT_ENCODER.max_length))
    return CodeBank(codes, jnp.array([[6, 5], [3, 3], [5, 4]]), captions, jnp.arange(3), jnp.ones(3, jnp.int32))


@case("models.rows.apply_compiled: encode")
def _() -> Case:
    mask = mask_from_lengths(jnp.array([16, 9]), 16)
    arguments = (tokenizer_variables(), normal(1, 2, 16, 263), mask)
    return Case(arguments, {"module": make_module(TOKENIZER), "method": "encode"}, atol=0)


def decoding() -> tuple:
    """Returns weights, statistics and codes."""
    return (tokenizer_variables(), on_device(walking_normalizer()), *codes_and_lengths())


@case("sampling.programs.decode_batch")
def _() -> Case:
    return Case(decoding(), {"tokenizer": make_module(TOKENIZER)}, rtol=1e-4, atol=1e-5)


@case("sampling.programs.decode_positions")
def _() -> Case:
    # Positions add up over the frames.
    return Case(decoding(), {"tokenizer": make_module(TOKENIZER), "skeleton": HUMANML3D}, rtol=1e-4, atol=1e-4)


@case("evaluation.prompts.recognition.fit_softmax")
def _() -> Case:
    return Case((normal(7, 20, 6), jnp.arange(20) % 7), {"num_classes": 7, "num_steps": 5}, rtol=1e-4, atol=1e-4)


def trembling() -> jax.Array:
    positions = np.stack([make_motion(kind, seed=0, num_frames=40) for kind in ("walk", "wave-left-hand")])
    return jnp.asarray(positions, jnp.float32) + 0.005 * normal(6, *positions.shape)


@case("motion.cleanup.clean_positions")
def _() -> Case:
    return Case((trembling(), jnp.array([40, 31])), {"skeleton": HUMANML3D}, rtol=1e-4, atol=1e-4)


@case("motion.cleanup._calm_clips")
def _() -> Case:
    options = {"skeleton": HUMANML3D, "bones": jnp.asarray(HUMANML3D.bone_lengths[1:])}
    return Case((trembling(), jnp.array([40, 31])), options, rtol=1e-4, atol=1e-4)


@case("motion.cleanup._lock_clips")
def _() -> Case:
    clips = (trembling(), trembling() + 0.002 * normal(7, 2, 40, 22, 3))
    return Case((*clips, jnp.array([40, 31])), {"skeleton": HUMANML3D}, rtol=1e-4, atol=1e-4)


@case("motion.paths._locked")
def _() -> Case:
    positions = jnp.asarray(make_motion("walk", seed=0, num_frames=40), jnp.float32)
    return Case((positions,), {"fps": 20.0, "skeleton": HUMANML3D}, rtol=1e-4, atol=1e-4)


@case("sampling.directing.approach_goals")
def _() -> Case:
    variables, normalizer, codes, lengths = decoding()
    targets = [read_target("0.3 left_wrist=0.2,1,0.1"), read_target("0.2 root=0.1,0.2")]
    goals = make_goals(targets, HUMANML3D)
    # Steps of Adam double the rounding of gradients near 0.
    options = {"tokenizer": make_module(TOKENIZER), "skeleton": HUMANML3D, "num_steps": 3}
    attempt = Attempt(codes[:1], lengths[:1], jnp.zeros((*codes[:1].shape[:2], TOKENIZER.code_dim)))
    return Case((variables, normalizer, attempt, goals), options, rtol=1e-3, atol=1e-3)


@case("sampling.programs.generate_codes")
def _() -> Case:
    variables, keys = weights(variable_shapes(GENERATOR)), jax.random.split(jax.random.key(4), 2)
    sampling = Sampling(Temperature(), StopAtEnd(), max_codes=6)
    return Case((variables, normal(5, 2, 16), keys), {"generator": make_module(GENERATOR), "sampling": sampling})


def row_arguments() -> tuple[tuple, dict[str, Any]]:
    """Returns what generating row by row needs, with guidance."""
    variables, generator = weights(variable_shapes(HIFIGPT)), make_module(HIFIGPT)
    return (variables, normal(5, 2, 16), jnp.float32(3.0)), {"generator": generator}


@case("sampling.programs.begin_motions")
def _() -> Case:
    return Case(*row_arguments())


@case("sampling.programs.generate_row")
def _() -> Case:
    arguments, options = row_arguments()
    state, keys = begin_motions(*arguments, **options), jax.random.split(jax.random.key(4), 2)
    sampling = Sampling(Temperature(), StopAtThreshold(), max_codes=6)
    return Case((arguments[0], state, keys), options | {"sampling": sampling})


@case("sampling.programs.begin_slots")
def _() -> Case:
    (variables, text, scale), options = row_arguments()
    state = begin_slots(variables, None, text, scale, jnp.ones(2, bool), **options)
    return Case((variables, state, 2 * text, scale, jnp.array([False, True])), options)


@case("sampling.programs.generate_in_slots")
def _() -> Case:
    (variables, text, scale), options = row_arguments()
    state = begin_slots(variables, None, text, scale, jnp.ones(2, bool), **options)
    sampling = Sampling(Temperature(), StopAtThreshold(), max_codes=12)
    return Case((variables, state, jax.random.split(jax.random.key(4), 2)), options | {"sampling": sampling})


@case("models.rows.apply_compiled: log_likelihood")
def _() -> Case:
    variables, text, _ = row_arguments()[0]
    codes = jnp.ones((2, 3, HIFIGPT.num_quantizers), jnp.int32)
    return Case((variables, codes, text), {"module": make_module(HIFIGPT), "method": "log_likelihood"})


@case("models.rows.apply_compiled: caption encoder")
def _() -> Case:
    shapes = jax.eval_shape(lambda: init_network(TEXT_ENCODER, jax.random.key(0)))
    options = {"module": CaptionEncoder(TEXT_ENCODER), "train": False}
    return Case((weights(shapes), *code_bank().captions), options)


@case("models.rows.apply_compiled: CLIP")
def _() -> Case:
    tokens = jnp.array([[1, 5, 19, 0, 0, 0], [1, 7, 3, 2, 4, 19]])
    shapes = jax.eval_shape(ClipText(CLIP).init, jax.random.key(0), tokens)
    return Case((weights(shapes), tokens), {"module": ClipText(CLIP)})


def sentence_case(**options: Any) -> Case:
    """Returns the case of a tiny sentence encoder."""
    tokens = jnp.array([[1, 5, 19, 2, 0, 0], [1, 7, 3, 2, 4, 19]])
    mask = jnp.arange(6)[None] < jnp.array([[4], [6]])
    config = SentenceEncoderConfig(
        vocabulary_size=20, max_length=6, embed_dim=16, num_layers=1, num_heads=2, mlp_dim=32, num_buckets=8
    )
    module = SentenceEncoder(config)
    shapes = jax.eval_shape(module.init, jax.random.key(0), tokens, mask)
    return Case((weights(shapes), tokens, mask), {"module": module} | options)


@case("models.rows.apply_compiled: sentence encoder")
def _() -> Case:
    return sentence_case()


@case("models.rows.apply_compiled: token states")
def _() -> Case:
    return sentence_case(method="states")


@case("models.rows.apply_compiled: state encoder")
def _() -> Case:
    shapes = jax.eval_shape(lambda: init_network(STATE_ENCODER, jax.random.key(0)))
    mask = mask_from_lengths(jnp.array([4, 6]), 6)
    options = {"module": StateEncoder(STATE_ENCODER), "train": False}
    return Case((weights(shapes), normal(1, 2, 6, 16), mask), options)


def evaluator_variables() -> Any:
    """Returns random weights of the evaluator."""
    return weights(evaluator_shapes(EVALUATOR_TRAINING.model))


@case("evaluation.embedding.embed_codes")
def _() -> Case:
    variables = (tokenizer_variables(), evaluator_variables())
    statistics = (on_device(walking_normalizer()),) * 2
    options = {"tokenizer": make_module(TOKENIZER), "evaluator": EVALUATOR_TRAINING.model}
    arguments = (variables, statistics, codes_and_lengths())
    return Case(arguments, options | {"max_frames": 10, "clear": True}, rtol=1e-4, atol=1e-5)


@case("evaluation.embedding.measure_features")
def _() -> Case:
    return Case((normal(1, 2, 16, 263), jnp.array([16, 9])), {"skeleton": HUMANML3D}, rtol=1e-4, atol=1e-4)


@case("models.rows.apply_compiled: evaluator")
def _() -> Case:
    words = map(jnp.asarray, WORDS.vectorize_all([("walk/VERB", "wave/VERB"), ("wave/VERB",)]))
    options = {"module": Evaluator(EVALUATOR_TRAINING.model), "method": "embed_text"}
    return Case((evaluator_variables(), *words), options, rtol=1e-4, atol=1e-5)


@case("evaluation.sources.sample_keys")
def _() -> Case:
    return Case((jax.random.key(1), jnp.arange(3), jnp.array([0, 5, 0])), {})


@case("metrics.retrieval.ranks_of_batches")
def _() -> Case:
    return Case((normal(1, 2, 4, 3), normal(2, 2, 4, 3), jnp.arange(8).reshape(2, 4) // 2), {})


@case("evaluation.reconstruction.reconstruct_batch")
def _() -> Case:
    features = jnp.asarray(walking_normalizer().denormalize(np.asarray(normal(1, 2, 16, 263))))
    arguments = (tokenizer_variables(), on_device(walking_normalizer()), features, jnp.array([16, 9]))
    return Case(arguments, {"tokenizer": make_module(TOKENIZER), "skeleton": HUMANML3D}, rtol=1e-4)


@case("train.vqvae.init_vqvae_state")
def _() -> Case:
    return Case((), {"config": VQVAE_TRAINING, "key": jax.random.key(0)})


def vqvae_state() -> Any:
    """Returns the state before the first update."""
    return init_vqvae_state(VQVAE_TRAINING, jax.random.key(0))


@case("train.vqvae.update")
def _() -> Case:
    return Case((vqvae_state(), motion_bank()), {"config": VQVAE_TRAINING}, **TRAINING_TOLERANCE)


@case("train.vqvae.validate")
def _() -> Case:
    return Case((vqvae_state(), motion_bank(), first_steps()), {"config": VQVAE_TRAINING}, **TRAINING_TOLERANCE)


@case("train.gpt.init_gpt_state")
def _() -> Case:
    return Case((), {"config": GPT_TRAINING, "key": jax.random.key(0)})


def gpt_state() -> Any:
    """Returns the state before the first update."""
    return init_gpt_state(GPT_TRAINING, jax.random.key(0))


@case("train.gpt.update")
def _() -> Case:
    return Case((gpt_state(), code_bank()), {"config": GPT_TRAINING}, **TRAINING_TOLERANCE)


@case("train.gpt.validate")
def _() -> Case:
    return Case((gpt_state(), code_bank(), first_steps()), {"config": GPT_TRAINING}, **TRAINING_TOLERANCE)


@case("train.hifigpt.init_hifigpt_state")
def _() -> Case:
    return Case((), {"config": HIFIGPT_TRAINING, "key": jax.random.key(0)})


def hifigpt_state() -> Any:
    """Returns the state before the first update, with a random codebook."""
    state = init_hifigpt_state(HIFIGPT_TRAINING, jax.random.key(0))
    return state._replace(codebook={"hifigpt": {"codebook": normal(7, 16, 16)}})


@case("train.hifigpt.update")
def _() -> Case:
    return Case((hifigpt_state(), code_bank(2)), {"config": HIFIGPT_TRAINING}, **TRAINING_TOLERANCE)


@case("train.hifigpt.validate")
def _() -> Case:
    return Case((hifigpt_state(), code_bank(2), first_steps()), {"config": HIFIGPT_TRAINING}, **TRAINING_TOLERANCE)


def state_table() -> StateTable:
    """Returns the states of three captions, of four, six and two tokens."""
    lengths = np.array([4, 6, 2], np.int32)
    starts = np.cumsum(lengths, dtype=np.int32) - lengths
    states = normal(1, 12, STATE_ENCODER.state_dim).astype(jnp.float16)
    return jax.tree.map(jnp.asarray, StateTable(states, starts, lengths, np.arange(3), np.arange(8)))


@case("train.teaching.embed_sentences")
def _() -> Case:
    params = init_network(STATE_ENCODER, jax.random.key(0))["params"]
    return Case((params, state_table(), jnp.array([2, 0])), {"network": STATE_ENCODER, "size": 4})


@case("train.teaching.teach_step")
def _() -> Case:
    config = TeachingConfig(network=STATE_ENCODER, optimizer=OPTIMIZER)
    state = first_state(init_network(STATE_ENCODER, jax.random.key(0))["params"], OPTIMIZER)
    inputs = (state_table(), jnp.array([2, 0]), normal(2, 2, 16), jax.random.key(1))
    return Case((state, *inputs), {"config": config, "size": 6}, **TRAINING_TOLERANCE)


@case("train.movement.init_movement_state")
def _() -> Case:
    return Case((), {"config": EVALUATOR_TRAINING, "key": jax.random.key(0)})


def movement_state() -> Any:
    """Returns the state before the first update."""
    return init_movement_state(EVALUATOR_TRAINING, jax.random.key(0))


@case("train.movement.update_movements")
def _() -> Case:
    return Case((movement_state(), motion_bank()), {"config": EVALUATOR_TRAINING}, **TRAINING_TOLERANCE)


@case("train.movement.validate_movements")
def _() -> Case:
    arguments = (movement_state(), motion_bank(), first_steps())
    return Case(arguments, {"config": EVALUATOR_TRAINING}, **TRAINING_TOLERANCE)


def matching_arguments() -> dict[str, Any]:
    """Returns the arguments of the first state of the matching."""
    movements = movement_state().params["movement_encoder"]
    return {
        "config": EVALUATOR_TRAINING,
        "key": jax.random.key(1),
        "movement_encoder": movements,
        "word_vectors": None,
    }


def matching_state() -> Any:
    """Returns the state before the first update."""
    return init_matching_state(**matching_arguments())


@case("train.evaluator.init_matching_state")
def _() -> Case:
    return Case((), matching_arguments())


@case("train.evaluator.update")
def _() -> Case:
    options = {"config": EVALUATOR_TRAINING, "max_frames": 24}
    return Case((matching_state(), caption_bank()), options, **TRAINING_TOLERANCE)


@case("train.evaluator.validate")
def _() -> Case:
    options = {"config": EVALUATOR_TRAINING, "max_frames": 24}
    return Case((matching_state(), caption_bank(), first_steps()), options, **TRAINING_TOLERANCE)
