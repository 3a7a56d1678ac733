"""Compares the graphs of `t2m export onnx` with JAX on sentences, and measures their sizes and times.

Greedy and sampled codes are compared, with the random numbers that JAX uses, and positions as decoded and cleaned.

    python docs/engines/parity.py MODEL FOLDER [MOTIONS]
"""

import functools
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from sampler import Noise, OnnxModel

from t2m_jax.motion.motion import Motion
from t2m_jax.sampling import TextToMotion
from t2m_jax.sampling.loop import STOP_STREAM, Sampling
from t2m_jax.sampling.request import SamplingOptions

WHO = ("a person", "somebody", "the old man", "a woman")
WHAT = (
    "walks forward", "waves with the left hand", "jogs and turns right", "walks in a circle", "raises both arms",
    "kicks with the right foot", "turns left while walking", "jumps twice", "stands still", "throws a ball",
    "walks backward slowly", "runs forward, then stops", "crouches and stands up", "points ahead with the right hand",
)  # fmt: skip
SENTENCES = [f"{who} {what}" for what in WHAT for who in WHO]


@functools.partial(jax.jit, static_argnames=("depth", "num_classes"))
def draw_noise(key: jax.Array, row: jax.Array, *, depth: int, num_classes: int) -> tuple[jax.Array, jax.Array]:
    """Returns the random numbers that JAX uses for a row: for codes [1, R, V], and for the end of the motion."""
    row_key = jax.random.fold_in(key, row)
    # T2M-GPT draws its code with the key of the row, T2M-HiFiGPT splits the key.
    keys = jax.random.split(row_key, depth) if depth > 1 else row_key[None]
    stop_key = jax.random.fold_in(jax.random.fold_in(key, STOP_STREAM), row)
    gumbel = jax.vmap(lambda key: jax.random.gumbel(key, (1, num_classes), jnp.float32)[0])(keys)
    return gumbel[None], jax.random.logistic(stop_key)


def jax_noise(graphs: OnnxModel, key: jax.Array, *, greedy: bool) -> Callable[[int], Noise]:
    """Returns a function from the number of a row to the noise of JAX; greedily, only the end is random."""
    _, depth, num_classes = graphs.manifest["graphs"]["row"]["inputs"]["noise"]["shape"]

    def noise(row: int) -> Noise:
        gumbel, logistic = jax.device_get(draw_noise(key, jnp.asarray(row), depth=depth, num_classes=num_classes))
        return Noise(np.zeros_like(gumbel) if greedy else gumbel, float(logistic))

    return noise


def jax_motion(
    model: TextToMotion, sentence: str, key: jax.Array, sampling: Sampling
) -> tuple[np.ndarray, Motion | None]:
    """Returns codes and motion by JAX; None if there are no codes."""
    sampled = model.parts.sample_codes(model.text_encoder([sentence]), key[None], sampling)
    codes = np.asarray(sampled.codes)[0, : int(sampled.code_lengths[0])]
    return codes, model.decode(codes) if len(codes) else None


def compare(model: TextToMotion, graphs: OnnxModel, sentences: list[str], *, greedy: bool) -> dict[str, float]:
    """Returns how many motions and rows there are, how many differ, and the largest distance of joints in mm.

    Distances are of motions whose codes are the same.
    """
    sampling = model.parts.sampling(SamplingOptions(temperature=0.0 if greedy else 1.0))
    counts = {
        "motions": 0,
        "rows": 0,
        "other_rows": 0,
        "other_motions": 0,
        "largest_mm": 0.0,
        "largest_cleaned_mm": 0.0,
    }
    for number, sentence in enumerate(sentences):
        key = jax.random.key(number)
        wanted, motion = jax_motion(model, sentence, key, sampling)
        found = graphs.sample(graphs.embed(sentence), jax_noise(graphs, key, greedy=greedy))
        size = max(len(wanted), len(found))
        same = sum(np.array_equal(*pair) for pair in zip(wanted, found, strict=False))
        counts["motions"] += 1
        counts["rows"] += size
        counts["other_rows"] += size - same
        counts["other_motions"] += same < size
        if same == size and motion is not None:
            decoded = graphs.decode(found)
            pairs = {
                "largest_mm": (decoded, motion.positions_raw),
                "largest_cleaned_mm": (graphs.clean(decoded), motion.positions),
            }
            for name, (ours, theirs) in pairs.items():
                counts[name] = max(counts[name], 1000 * float(np.linalg.norm(ours - theirs, axis=-1).max()))
    return counts


def times(graphs: OnnxModel, sentence: str, repeats: int = 20) -> dict[str, float]:
    """Returns the median time of each graph in milliseconds."""
    embedding = graphs.embed(sentence)
    codes = graphs.sample(embedding, graphs.random_noise(0))
    inputs = {"text_embedding": embedding, "guidance_scale": graphs.manifest["sampling"]["guidance_scale"]}
    state = graphs.run("begin", inputs)
    drawn = {"noise": graphs.random_noise(0)(0).gumbel, "temperature": 1.0, "may_stop": 1}
    shape = graphs.manifest["graphs"]["calm"]["inputs"]["positions"]["shape"]
    clip = {"positions": np.zeros(shape, np.float32), "num_frames": shape[1]}
    works = {
        "text": lambda: graphs.embed(sentence),
        "begin": lambda: graphs.run("begin", inputs),
        "row": lambda: graphs.run("row", drawn | state),
        "decode": lambda: graphs.decode(codes),
        "calm": lambda: graphs.run("calm", clip),
        "lock": lambda: graphs.run("lock", clip | {"calm_positions": clip["positions"]}),
    }
    found = {}
    for name, work in works.items():
        spent = []
        for _ in range(repeats):
            begun = time.perf_counter()
            work()
            spent.append(time.perf_counter() - begun)
        found[name] = 1000 * float(np.median(spent))
    return found


def main() -> None:
    """Prints the figures of a model."""
    name, folder, *rest = sys.argv[1:]
    model = TextToMotion.load(name)
    graphs = OnnxModel(Path(folder), threads=2)
    count = int(rest[0]) if rest else len(SENTENCES)
    sentences = [SENTENCES[number % len(SENTENCES)] for number in range(count)]
    for graph, spent in times(graphs, sentences[0]).items():
        size = graphs.manifest["files"][f"{graph}.onnx"]["bytes"]
        print(f"{graph}: {size / 1e6:.1f} MB, {spent:.1f} ms")  # noqa: T201
    for greedy in (True, False):
        print("greedy" if greedy else "sampled", compare(model, graphs, sentences, greedy=greedy), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
