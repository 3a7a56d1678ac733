"""Makes the files of tests/golden/torch with PyTorch: small, and everything that a state dict of the field may hold.

    pip install -e '.[parity]'
    python -m tests.parity.make_torch_files

What they hold is said once more without PyTorch, in tests/checkpoints/test_torch_file.py.
"""

from collections import OrderedDict
from pathlib import Path

import torch

FOLDER = Path(__file__).parents[1] / "golden" / "torch"


def content() -> dict:
    """Returns a training checkpoint in small."""
    base = torch.arange(24, dtype=torch.float32).reshape(4, 6)
    layer = torch.nn.Linear(3, 2)
    with torch.no_grad():
        layer.weight.copy_(torch.arange(6.0).reshape(2, 3))
        layer.bias.copy_(torch.tensor([0.5, -0.5]))
    optimizer = torch.optim.Adam(layer.parameters(), lr=0.25)
    layer(torch.ones(1, 3)).sum().backward()
    optimizer.step()
    numbers = torch.tensor([0, 1, -2, 100])
    kinds = ("float64", "float32", "float16", "bfloat16", "int64", "int32", "int16", "int8", "uint8", "bool")
    return {
        "net": OrderedDict(layer.state_dict()),
        "opt": optimizer.state_dict(),
        "epoch": 3,
        "best": 0.125,
        "name": "größe",
        "done": True,
        "nothing": None,
        "list": [1, (2, -70000), [], {}],
        "big": 2**40,
        "kinds": {kind: numbers.to(getattr(torch, kind)) for kind in kinds},
        "transposed": base.T,
        "rows": base[1:3],
        "columns": base[:, 1::2],
        "scalar": base[2, 3],
        "empty": torch.zeros(0, 5),
        "parameter": torch.nn.Parameter(torch.ones(2)),
        "size": base.shape,
    }


def main() -> None:
    """Writes one file for each format and protocol."""
    FOLDER.mkdir(exist_ok=True)
    torch.save(content(), FOLDER / "zip.pth")
    torch.save(content(), FOLDER / "protocol4.pth", pickle_protocol=4)
    torch.save(content(), FOLDER / "legacy.tar", _use_new_zipfile_serialization=False)
    # Refused by name: neither holds tensors, numbers and strings alone.
    torch.save(torch.nn.Linear(2, 2), FOLDER / "module.pth")
    torch.save({"dtype": torch.float32}, FOLDER / "dtype.pth")


if __name__ == "__main__":
    main()
