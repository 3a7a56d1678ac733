"""Tables of the package: TOML files beside the modules that read them."""

import tomllib
from pathlib import Path
from typing import Any


def packaged_table(module: str, name: str) -> dict[str, Any]:
    """Returns the table of a name that is beside a module, given by its `__file__`."""
    return tomllib.loads(Path(module).with_name(f"{name}.toml").read_text(encoding="utf-8"))
