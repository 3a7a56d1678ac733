"""The tiny CLIPs of tests/golden/clip, whole or with some of their files only."""

import json
import shutil
from pathlib import Path

import numpy as np

GOLDEN = Path(__file__).parent / "golden" / "clip"
FULL, TEXT_ONLY = GOLDEN / "full", GOLDEN / "text_only"
CAPTIONS = json.loads((GOLDEN / "captions.json").read_text(encoding="utf-8"))
SAFETENSORS, MSGPACK, TORCH = "model.safetensors", "flax_model.msgpack", "pytorch_model.bin"
ONE_FILE, TWO_FILES = ("tokenizer.json",), ("vocab.json", "merges.txt")


def golden(folder: Path, what: str) -> np.ndarray:
    """Returns `tokens` or `embeddings` of the captions as the reference made them."""
    with np.load(GOLDEN / "golden.npz") as arrays:
        return arrays[f"{folder.name}/{what}"]


def copy_files(
    source: Path, target: Path, *, weights: str = SAFETENSORS, tokenizer: tuple[str, ...] = ONE_FILE
) -> Path:
    """Returns `target`, a folder with one weight file and one form of the tokenizer."""
    target.mkdir(parents=True)
    for name in ("config.json", weights, *tokenizer):
        shutil.copy(source / name, target)
    return target
