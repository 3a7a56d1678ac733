"""The tiny sentence encoders of tests/golden/sentence, which tests/parity/make_sentence_fixture.py made."""

import json
import shutil
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

GOLDEN = Path(__file__).parent / "golden" / "sentence"
BERT, MPNET, ROBERTA = GOLDEN / "bert", GOLDEN / "mpnet", GOLDEN / "roberta"
FOLDERS = (BERT, MPNET, ROBERTA)
CAPTIONS = json.loads((GOLDEN / "captions.json").read_text(encoding="utf-8"))


def golden(folder: Path) -> np.ndarray:
    """Returns the embeddings of the captions as the reference made them."""
    with np.load(GOLDEN / "golden.npz") as arrays:
        return arrays[folder.name]


def copy_encoder(source: Path, target: Path) -> Path:
    """Returns `target`, a copy of an encoder that may be changed."""
    return Path(shutil.copytree(source, target))


def wide_encoder(target: Path) -> Path:
    """Returns `target`, a copy of `BERT` whose embeddings have 384 numbers, as those of the presets' encoders."""
    copy_encoder(BERT, target)
    weights = load_file(target / "model.safetensors")
    for axis in (0, 1):
        weights = {
            name: np.repeat(value, 16, axis=axis) if axis < value.ndim and value.shape[axis] == 24 else value
            for name, value in weights.items()
        }
    save_file(weights, target / "model.safetensors")
    change_json(target / "config.json", hidden_size=384)
    change_json(target / "1_Pooling" / "config.json", embedding_dimension=384)
    return target


def change_json(path: Path, **changes: object) -> None:
    """Changes fields of a JSON file, which may not exist; a field that becomes None is removed."""
    data = json.loads(path.read_text()) if path.exists() else {}
    kept = {name: value for name, value in (data | changes).items() if value is not None}
    path.write_text(json.dumps(kept))
