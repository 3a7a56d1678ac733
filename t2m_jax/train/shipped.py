"""The configs that come with the package, by name.

`t2m-gpt/vqvae` is `configs/t2m-gpt/vqvae.yaml`. Presets are the configs of the published trainings, YAML files in the
folder `recipes`. T2M-GPT: `official` follows the published commands, `paper` follows the text of the paper.
`docs/paper_and_code.md` lists every difference and the reason for each choice. T2M-HiFiGPT has no published code:
`hifigpt/paper` follows its paper, and `docs/hifigpt.md` says what the paper leaves open.
"""

import difflib
import re
from pathlib import Path
from typing import Any, NamedTuple

from t2m_jax.config import flat_fields, load_config
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_text
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.train.experiment import find_trainer

RECIPES = Path(__file__).with_name("recipes")
"""Has a file for each data set in a folder for each kind and recipe."""
DATA_SETS = (HUMANML3D.name, KIT_ML.name)
"""The data sets that have presets. Names without a data set are for the first."""
_COMMAND = re.compile(r"^#\s+t2m train (\w+) configs/", re.MULTILINE)


def preset_names(kind: str = "*") -> tuple[str, ...]:
    """Returns the names of the presets of a kind, or of all.

    A name is a recipe for HumanML3D, or a data set and a recipe such as `kit_ml/paper`.
    """
    files = sorted(RECIPES.glob(f"{kind}/**/{DATA_SETS[0]}.yaml"))
    recipes = dict.fromkeys("/".join(file.parent.relative_to(RECIPES).parts[1:]) for file in files)
    return (*recipes, *(f"{data}/{recipe}" for data in DATA_SETS for recipe in recipes))


def load_preset(stage: str, name: str) -> Any:
    """Returns the config of a stage by a name such as "paper", "humanml3d/paper" or "kit_ml/official".

    Raises:
        UserError: There is no such preset.
    """
    if name not in preset_names(stage):
        raise UserError(f"{name}: no preset of stage {stage}; known: {', '.join(preset_names(stage)) or 'none'}")
    data = name.partition("/")[0] if name.startswith(DATA_SETS) else DATA_SETS[0]
    schema: Any = find_trainer(stage).config
    return load_config(RECIPES / stage / name.removeprefix(f"{data}/") / f"{data}.yaml", schema)


def differences(one: Any, other: Any) -> dict[str, tuple[Any, Any]]:
    """Returns the fields in which two configs of the same stage differ, with both values."""
    left = flat_fields(one)
    right = flat_fields(other)
    return {name: (left[name], right[name]) for name in left if left[name] != right[name]}


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
