"""Configs of the published trainings, which are YAML files in the folder `recipes`.

T2M-GPT: `official` follows the published commands, `paper` follows the text of the paper. `docs/paper_and_code.md`
lists every difference and the reason for each choice. T2M-HiFiGPT has no published code: `hifigpt/paper` follows its
paper, and `docs/hifigpt.md` says what the paper leaves open.
"""

from pathlib import Path
from typing import Any

from t2m_jax.config import flat_fields, load_config
from t2m_jax.errors import UserError
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.train.experiment import find_trainer

RECIPES = Path(__file__).with_name("recipes")
"""Has a file for each data set in a folder for each kind and recipe."""
DATA_SETS = (HUMANML3D.name, KIT_ML.name)
"""The data sets that have presets. Names without a data set are for the first."""


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
