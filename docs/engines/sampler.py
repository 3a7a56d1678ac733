"""Makes a motion with the graphs of `t2m export onnx`; needs only NumPy, onnxruntime and tokenizers.

    python docs/engines/sampler.py FOLDER "a person waves with the left hand" wave.npy

It is written to be read: `docs/engines.md` explains each step, and tests compare it with the package.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnxruntime
from tokenizers import Tokenizer


class Noise(NamedTuple):
    """The random numbers of a row."""

    gumbel: np.ndarray
    """Added to the logits of its codes, [1, R, V]; zeros take the likeliest codes."""
    logistic: float
    """Added to its stop score, with the rule `sampled`."""


def uniform(seed: int, first: int, count: int) -> np.ndarray:
    """Returns numbers of a seed, above 0 and below 1: SplitMix64, which is a few lines in every language."""
    bits = np.arange(first + 1, first + count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(seed)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (((bits ^ (bits >> np.uint64(31))) >> np.uint64(12)) + 0.5) / 2**52


class OnnxModel:
    """The graphs of an exported model, for one motion at a time."""

    def __init__(self, folder: Path, *, threads: int = 0):
        """Reads the manifest and the graphs; 0 threads are as many as there are cores."""
        self.manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        self.graphs = {
            name: onnxruntime.InferenceSession(folder / graph["file"], options)
            for name, graph in self.manifest["graphs"].items()
        }
        self.tokenizer = Tokenizer.from_file(str(folder / self.manifest["text"]["tokenizer"]))

    def run(self, name: str, inputs: dict[str, Any]) -> dict[str, np.ndarray]:
        """Returns the outputs of a graph by name; inputs get the type and shape that the manifest says."""
        graph = self.manifest["graphs"][name]
        arrays = {
            key: np.asarray(inputs[key], entry["dtype"]).reshape(entry["shape"])
            for key, entry in graph["inputs"].items()
        }
        return dict(zip(graph["outputs"], self.graphs[name].run(list(graph["outputs"]), arrays), strict=True))

    def embed(self, sentence: str) -> np.ndarray:
        """Returns the text embedding of a sentence, [1, E]."""
        text = self.manifest["text"]
        size, marks = text["max_tokens"], text["marks"]
        tokens = self.tokenizer.encode(sentence, add_special_tokens=not marks).ids
        if marks:  # CLIP: a start, the sentence, and ends as far as there is room
            tokens = [marks["start"], *tokens[: size - 2], *[marks["end"]] * size]
        tokens = tokens[:size]
        padded = tokens + [0] * (size - len(tokens))
        return self.run("text", {"tokens": padded, "num_tokens": len(tokens)})["text_embedding"]

    def random_noise(self, seed: int) -> Callable[[int], Noise]:
        """Returns a function from the number of a row to its noise, the same in all languages."""
        shape = self.manifest["graphs"]["row"]["inputs"]["noise"]["shape"]
        size = int(np.prod(shape)) + 1

        def noise(row: int) -> Noise:
            numbers = uniform(seed, row * size, size)
            gumbel = -np.log(-np.log(numbers[:-1]))
            return Noise(gumbel.astype(np.float32).reshape(shape), float(np.log(numbers[-1] / (1 - numbers[-1]))))

        return noise

    def sample(
        self,
        embedding: np.ndarray,
        noise: Callable[[int], Noise],
        *,
        temperature: float = 1.0,
        guidance_scale: float | None = None,
    ) -> np.ndarray:
        """Returns the codes of a motion, [N, R]; the noise is asked for row by row."""
        rules = self.manifest["sampling"]
        scale = rules["guidance_scale"] if guidance_scale is None else guidance_scale
        state = self.run("begin", {"text_embedding": embedding, "guidance_scale": scale})
        keeps_last = rules["stop"]["keeps_last"]
        rows: list[np.ndarray] = []
        scores: list[float] = []
        while len(rows) < rules["max_rows"]:
            drawn = noise(len(rows))
            may_stop = len(rows) >= rules["min_rows"] - keeps_last
            given = {"noise": drawn.gumbel, "temperature": temperature, "may_stop": may_stop}
            found = self.run("row", given | state)
            state = {name: found[rules["next"] + name] for name in rules["state"]}
            rows.append(found["codes"][0])
            scores.append(float(found["stop_score"][0]) if may_stop else -np.inf)
            if self.ends(scores[-1], drawn):
                return np.array(rows if keeps_last else rows[:-1], np.int32).reshape(-1, len(rows[0]))
        if rules["stop"]["rule"] == "argmax":
            rows = rows[: int(np.argmax(scores)) + 1]
        return np.array(rows, np.int32)

    def ends(self, score: float, noise: Noise) -> bool:
        """Returns whether a motion ends with a row of this stop score."""
        stop = self.manifest["sampling"]["stop"]
        return {
            "end": score > 0.5,
            "threshold": 1 / (1 + np.exp(-score)) >= stop["threshold"],
            "sampled": score + noise.logistic > 0,
            "argmax": False,  # the longest motion is sampled, and then cut
        }[stop["rule"]]

    def decode(self, codes: np.ndarray) -> np.ndarray:
        """Returns joint positions of codes in meters, [T, J, 3]."""
        size = self.manifest["sampling"]["max_rows"]
        padded = np.pad(codes, ((0, size - len(codes)), (0, 0)))
        found = self.run("decode", {"codes": padded, "num_rows": len(codes)})
        return found["positions"][0, : len(codes) * self.manifest["motion"]["frames_per_row"]]

    def clean(self, positions: np.ndarray) -> np.ndarray:
        """Returns the positions of `decode` with less trembling, bones of constant length, and feet that stand."""
        size = self.manifest["graphs"]["calm"]["inputs"]["positions"]["shape"][1]
        padded = np.pad(positions, ((0, size - len(positions)), (0, 0), (0, 0)))[None]
        given = {"positions": padded, "num_frames": len(positions)}
        return self.run("lock", given | self.run("calm", given))["clean_positions"][0, : len(positions)]


if __name__ == "__main__":
    folder, sentence, output = sys.argv[1:]
    model = OnnxModel(Path(folder))
    positions = model.clean(model.decode(model.sample(model.embed(sentence), model.random_noise(seed=0))))
    np.save(output, positions)
    print(f"{output}: {positions.shape} at {model.manifest['motion']['fps']:g} frames a second")  # noqa: T201
