"""The parts of a model as functions of named arrays, for one motion at a time.

All functions come from the interface of systems (`t2m_jax.models.system`), so any system can be exported. There are no
random numbers in them: noise is an input.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.errors import UserError
from t2m_jax.export.onnx.text import TextPart
from t2m_jax.keys import new_key
from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.system import make_module
from t2m_jax.motion.cleanup import calm_clip, lock_clip
from t2m_jax.motion.features import positions_from_features
from t2m_jax.motion.normalizer import Normalizer
from t2m_jax.motion.skeleton import skeleton_from_name
from t2m_jax.sampling.programs import decode_positions

NEXT = "next_"
"""Begins the names of the arrays that a row gives to the next row, which reads them without it."""


class Graph(NamedTuple):
    """A part of a model, from its weights to a file."""

    function: Callable[..., Sequence[Array]]
    """From the inputs, in order, to the outputs, in order."""
    inputs: Mapping[str, jax.ShapeDtypeStruct]
    outputs: Mapping[str, jax.ShapeDtypeStruct]


def make_graph(
    function: Callable[..., Sequence[Array]], inputs: Mapping[str, jax.ShapeDtypeStruct], names: Sequence[str]
) -> Graph:
    """Returns a graph whose outputs have the given names."""
    shapes = jax.eval_shape(function, *inputs.values())
    return Graph(function, inputs, dict(zip(names, shapes, strict=True)))


def array_of(*shape: int, dtype: Any = jnp.float32) -> jax.ShapeDtypeStruct:
    """Returns the shape and type of an array."""
    return jax.ShapeDtypeStruct(shape, dtype)


def make_graphs(bundle: Bundle, text: TextPart, *, sentences: int = 1) -> dict[str, Graph]:
    """Returns the graphs of a model by name: `text`, `begin`, `row`, `decode`, `calm` and `lock`.

    With more `sentences` than one, motions of `lock` are so much longer, and `place` makes positions of their features.
    """
    return {
        "text": _text_graph(text),
        **_generator_graphs(bundle),
        "decode": _decode_graph(bundle),
        **_clean_graphs(bundle, sentences),
        **({"place": _place_graph(bundle, sentences)} if sentences > 1 else {}),
    }


def _text_graph(text: TextPart) -> Graph:
    """Returns the graph from the tokens of a sentence to its embedding; tokens after its end have no influence."""

    def embed(tokens: Int[Array, "1 S"], num_tokens: Int[Array, "1"]) -> tuple[Array, ...]:
        return text.embed(tokens, mask_from_lengths(num_tokens, tokens.shape[1]))

    inputs = {"tokens": array_of(1, text.num_tokens, dtype=jnp.int32), "num_tokens": array_of(1, dtype=jnp.int32)}
    return make_graph(embed, inputs, text.outputs)


def _generator_graphs(bundle: Bundle) -> dict[str, Graph]:
    """Returns the graphs of the state before the first row, and of one row and the state after it."""
    config = bundle.config.generator
    apply = functools.partial(make_module(config).apply, bundle.variables["generator"])
    inputs = {"text_embedding": array_of(1, config.text_dim)}
    if config.guidance_scale is not None:
        inputs["guidance_scale"] = array_of(1)

    def begin(text_embedding: Float[Array, "1 E"], scale: Float[Array, "1"] | None = None) -> Any:
        context, cache = apply(text_embedding, None if scale is None else scale[0], method="begin")
        return {"context": context, "cache": cache}

    paths, tree = jax.tree_util.tree_flatten_with_path(jax.eval_shape(begin, *inputs.values()))
    state = {jax.tree_util.keystr(path, simple=True, separator="_"): leaf for path, leaf in paths}
    state = {name: array_of(*leaf.shape, dtype=leaf.dtype) for name, leaf in state.items()}

    drawn = {"noise": array_of(1, config.num_quantizers, num_classes(bundle)), "temperature": array_of(1)}
    drawn["may_stop"] = array_of(1, dtype=jnp.int32)
    names = ["codes", "stop_score", *(f"{NEXT}{name}" for name in state)]
    try:
        row = make_graph(functools.partial(_row, apply, tree), drawn | state, names)
    except TypeError as error:
        raise UserError(f"export: {config.kind!r} cannot draw with noise for keys; see docs/systems.md") from error
    return {"begin": make_graph(lambda *given: jax.tree.leaves(begin(*given)), inputs, list(state)), "row": row}


def _row(
    apply: Callable[..., Any],
    tree: Any,
    noise: Float[Array, "1 R V"],
    temperature: Float[Array, "1"],
    may_stop: Int[Array, "1"],
    *state: Array,
) -> list[Array]:
    """Returns the codes of a row, its stop score, and the state after it; `tree` is the structure of the state."""

    def choose(logits: Float[Array, "1 V"], noise: Float[Array, "..."]) -> Int[Array, "1"]:
        # With Gumbel noise, this is a draw from the softmax; without noise, the likeliest.
        return jnp.argmax(logits / temperature[:, None] + noise.reshape(logits.shape), axis=1)

    before = jax.tree.unflatten(tree, state)
    codes = apply(before["context"], noise, choose, may_stop=may_stop > 0, method="draw")
    context, score, cache = apply(before["cache"], codes, method="step")
    return [codes, score, *jax.tree.leaves({"context": context, "cache": cache})]


def num_classes(bundle: Bundle) -> int:
    """Returns among how many tokens a generator chooses each code (V): codes, and perhaps End."""
    config = bundle.config.generator
    found = []

    def note(logits: Float[Array, "1 V"], key: Any) -> Int[Array, "1"]:
        del key
        found.append(logits.shape[-1])
        return jnp.argmax(logits, axis=-1)

    def draw(text_embedding: Float[Array, "1 E"], keys: Any) -> Any:
        apply = functools.partial(make_module(config).apply, bundle.variables["generator"])
        context, _ = apply(text_embedding, method="begin")
        return apply(context, keys, note, may_stop=jnp.ones(1, bool), method="draw")

    # Shapes are enough, so nothing is computed.
    jax.eval_shape(draw, array_of(1, config.text_dim), jax.eval_shape(lambda: jax.random.split(new_key(0), 1)))
    return found[0]


def _decode_graph(bundle: Bundle) -> Graph:
    config = bundle.config
    skeleton = skeleton_from_name(config.skeleton)
    normalizer = Normalizer(*map(jnp.asarray, bundle.normalizer))

    def decode(codes: Int[Array, "1 N R"], num_rows: Int[Array, "1"]) -> tuple[Float[Array, "..."], ...]:
        parts: dict[str, Any] = {"tokenizer": make_module(config.tokenizer), "skeleton": skeleton}
        features, positions = decode_positions(bundle.variables["tokenizer"], normalizer, codes, num_rows, **parts)
        return positions * np.float32(skeleton.metres_per_unit), features

    codes = array_of(1, config.generator.max_codes, config.tokenizer.num_quantizers, dtype=jnp.int32)
    return make_graph(decode, {"codes": codes, "num_rows": array_of(1, dtype=jnp.int32)}, ["positions", "features"])


def _most_frames(bundle: Bundle) -> int:
    """Returns the frames of the longest motion of a sentence."""
    return bundle.config.generator.max_codes * bundle.config.tokenizer.downsample


def _place_graph(bundle: Bundle, sentences: int) -> Graph:
    skeleton = skeleton_from_name(bundle.config.skeleton)

    def place(features: Float[Array, "1 T D"]) -> tuple[Float[Array, "1 T J 3"]]:
        return (positions_from_features(features, skeleton) * np.float32(skeleton.metres_per_unit),)

    frames = sentences * _most_frames(bundle)
    return make_graph(place, {"features": array_of(1, frames, skeleton.feature_dim)}, ["positions"])


def _clean_graphs(bundle: Bundle, sentences: int) -> dict[str, Graph]:
    """Returns the graphs of the clean-up: of trembling and bones, and then of feet."""
    skeleton = skeleton_from_name(bundle.config.skeleton)
    clip = array_of(1, _most_frames(bundle), skeleton.num_joints, 3)
    longest = array_of(1, sentences * _most_frames(bundle), skeleton.num_joints, 3)
    length = array_of(1, dtype=jnp.int32)

    def calm(positions: Float[Array, "1 T J 3"], num_frames: Int[Array, "1"]) -> tuple[Float[Array, "1 T J 3"]]:
        return (calm_clip(positions[0], num_frames[0], skeleton)[None],)

    def lock(
        calm: Float[Array, "1 T J 3"], positions: Float[Array, "1 T J 3"], num_frames: Int[Array, "1"]
    ) -> tuple[Float[Array, "1 T J 3"]]:
        return (lock_clip(calm[0], positions[0], num_frames[0], skeleton)[None],)

    return {
        "calm": make_graph(calm, {"positions": clip, "num_frames": length}, ["calm_positions"]),
        "lock": make_graph(
            lock, {"calm_positions": longest, "positions": longest, "num_frames": length}, ["clean_positions"]
        ),
    }
