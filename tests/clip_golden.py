"""The tiny CLIPs of tests/golden/clip, whole or with some of their files only."""

import json
import shutil
from pathlib import Path

import numpy as np

GOLDEN = Path(__file__).parent / "golden" / "clip"
FULL, TEXT_ONLY = GOLDEN / "full", GOLDEN / "text_only"
CAPTIONS = json.loads((GOLDEN / "captions.json").read_text(encoding="utf-8"))
SAFETENSORS, TORCH = "model.safetensors", "pytorch_model.bin"


def golden(folder: Path, what: str) -> np.ndarray:
    """Returns `tokens` or `embeddings` of the captions as the reference made them."""
    with np.load(GOLDEN / "golden.npz") as arrays:
        return arrays[f"{folder.name}/{what}"]


def copy_files(source: Path, target: Path, *, weights: str = SAFETENSORS) -> Path:
    """Returns `target`, a folder with one weight file."""
    target.mkdir(parents=True)
    for name in ("config.json", "tokenizer.json", weights):
        shutil.copy(source / name, target)
    return target
