"""The folder of an exported model: graphs, tokenizer, card, and a manifest that says how to use them."""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from t2m_jax.checkpoints.bundle import CARD_FILE, Bundle
from t2m_jax.export.onnx.builder import OPSET
from t2m_jax.export.onnx.convert import save_graph
from t2m_jax.export.onnx.graphs import NEXT, Graph, make_graphs
from t2m_jax.export.onnx.text import TextPart, text_part
from t2m_jax.files.reading import load_bytes
from t2m_jax.files.writing import atomic_folder, save_json, save_text
from t2m_jax.models.system import find_part
from t2m_jax.motion.skeleton import skeleton_from_name
from t2m_jax.sampling.stopping import find_stop_rule
from t2m_jax.text.bpe import TOKENIZER_FILE, save_bpe

MANIFEST_FILE = "manifest.json"
FORMAT_VERSION = 1
"""Version of the manifest."""


def export_onnx(folder: Path, bundle: Bundle, *, sentences: int = 1) -> None:
    """Writes a model as ONNX graphs for one motion at a time; the folder appears complete or not at all.

    Args:
        folder: It must not exist.
        bundle: The model.
        sentences: Of the longest motion. With 1, there is no graph that only several sentences need.

    Raises:
        UserError: `folder` exists already, or the model cannot be exported.
    """
    # As sampling has them: modules may index weights with arrays of JAX.
    bundle = bundle._replace(variables=jax.device_put(bundle.variables))
    with atomic_folder(folder) as partial:
        text = text_part(bundle)
        graphs = make_graphs(bundle, text, sentences=sentences)
        for name, graph in tqdm(graphs.items(), desc="converting", unit="graph", disable=None):
            save_graph(partial / f"{name}.onnx", graph, quantized=text.quantized if name == "text" else ())
        save_bpe(partial, text.tokenizer)
        if bundle.card:
            save_text(partial / CARD_FILE, bundle.card)
        save_json(partial / MANIFEST_FILE, _manifest(partial, bundle, text, graphs))


def _manifest(folder: Path, bundle: Bundle, text: TextPart, graphs: Mapping[str, Graph]) -> dict[str, Any]:
    """Returns what a program needs to know to make motions with the graphs."""
    return {
        "format_version": FORMAT_VERSION,
        "opset": OPSET,
        "source": bundle.source,
        "license": bundle.license,
        "card": CARD_FILE if bundle.card else None,
        "examples": list(bundle.examples),
        "files": file_records(folder, sorted(folder.iterdir())),
        "graphs": {name: _arrays(name, graph) for name, graph in graphs.items()},
        "text": {"tokenizer": TOKENIZER_FILE, "max_tokens": text.num_tokens, "marks": dict(text.marks)},
        "sampling": _sampling(bundle, graphs["row"]),
        "motion": _motion(bundle),
    }


def file_records(folder: Path, paths: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """Returns the size and digest of each file by its path in the folder."""
    records = {}
    for path in paths:
        data = load_bytes(path)
        digest = hashlib.sha256(data).hexdigest()
        records[path.relative_to(folder).as_posix()] = {"bytes": len(data), "sha256": digest}
    return records


def _arrays(name: str, graph: Graph) -> dict[str, Any]:
    """Returns the file of a graph, and shapes and types of its inputs and outputs."""
    sides = {"inputs": graph.inputs, "outputs": graph.outputs}
    described = {
        side: {name: {"shape": list(array.shape), "dtype": str(array.dtype)} for name, array in arrays.items()}
        for side, arrays in sides.items()
    }
    return {"file": f"{name}.onnx", **described}


def _sampling(bundle: Bundle, row: Graph) -> dict[str, Any]:
    """Returns how rows follow each other, and when a motion ends."""
    config = bundle.config.generator
    rule = find_stop_rule(config)
    return {
        "max_rows": config.max_codes,
        "min_rows": min(bundle.min_codes, config.max_codes),
        "state": [name.removeprefix(NEXT) for name in row.outputs if name.startswith(NEXT)],
        "next": NEXT,
        "num_codes": config.num_codes,
        "guidance_scale": config.guidance_scale,
        "temperature": 1.0,
        "noise": "gumbel",
        "stop": {
            "rule": config.stop_rule,
            "threshold": find_part(config.kind).stop_threshold(config),
            "keeps_last": rule.keeps_last,
        },
    }


def _motion(bundle: Bundle) -> dict[str, Any]:
    """Returns what the numbers of a motion are."""
    skeleton = skeleton_from_name(bundle.config.skeleton)
    return {
        "fps": skeleton.fps,
        "frames_per_row": bundle.config.tokenizer.downsample,
        "context_rows": bundle.config.tokenizer.decoder_context,
        "unit": "meter",
        "up": "+Y",
        "ahead": "+Z",
        "left": "+X",
        "skeleton": skeleton.name,
        "joints": list(skeleton.joint_names),
        "parents": list(skeleton.parents),
        "rest_offsets": (skeleton.offsets * skeleton.metres_per_unit).astype(float).round(6).tolist(),
        # The graph `decode` has applied these already.
        "statistics": {
            name: np.asarray(values, float).tolist() for name, values in bundle.normalizer._asdict().items()
        },
    }
