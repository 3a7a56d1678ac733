"""The configs that come with the package, by name: `t2m-gpt/vqvae` is `configs/t2m-gpt/vqvae.yaml`."""

import difflib
import re
from pathlib import Path
from typing import NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_text
from t2m_jax.train.presets import preset_names

_COMMAND = re.compile(r"^#\s+t2m train (\w+) configs/", re.MULTILINE)


class ShippedConfig(NamedTuple):
    """A config that comes with the package."""

    kind: str
    """What it trains."""
    path: Path
    """Its file."""
    summary: str
    """What it is, in a sentence."""


def config_folder() -> Path:
    """Returns the folder of the configs: in the package, or next to it in a source tree."""
    package = Path(__file__).parents[1]
    # A wheel has the configs inside of the package.
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def shipped_configs() -> dict[str, ShippedConfig]:
    """Returns the configs by name. Their first comment says what they are and how they are used."""
    folder = config_folder()
    found = {}
    for path in sorted(folder.rglob("*.yaml")):
        text = load_text(path)
        # Files without a command are parts of a recipe, such as the description of a data set.
        if command := _COMMAND.search(text):
            comment = " ".join(line.strip("# ") for line in text[: command.start()].splitlines())
            name = path.relative_to(folder).with_suffix("").as_posix()
            found[name] = ShippedConfig(command[1], path, re.split(r"(?<=[.:])\s", comment)[0].rstrip(":"))
    return found


def find_config(kind: str, name: str) -> Path:
    """Returns the file of a config that comes with the package.

    Args:
        kind: What it trains.
        name: Such as `t2m-gpt/vqvae`, or with its folder and suffix: `configs/t2m-gpt/vqvae.yaml`.

    Raises:
        UserError: There is no such config; similar names are suggested.
    """
    configs = shipped_configs()
    short = name.removeprefix("configs/").removesuffix(".yaml")
    if short in configs:
        return configs[short].path
    known = [*(name for name in configs if configs[name].kind == kind), *preset_names(kind)]
    near = difflib.get_close_matches(short, known, n=3)
    hint = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
    raise UserError(f"{name}: there is no such file, config or preset; {hint}`t2m train --list` shows all names")
