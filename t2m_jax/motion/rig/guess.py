"""The best guess of a table for a rig that is not known by name, for a person to check."""

import math

import yaml

from t2m_jax.errors import UserError, printable
from t2m_jax.motion.rig.clip import RigClip
from t2m_jax.motion.rig.orientation import left_is_left
from t2m_jax.motion.rig.recognition import guess_table
from t2m_jax.motion.rig.retarget import find_rig, retarget
from t2m_jax.motion.rig.rigs import OPTIONAL_JOINTS
from t2m_jax.motion.skeleton import HUMANML3D


def rig_table_text(clip: RigClip, *, source: str) -> str:
    """Returns the guess for a clip as the text of a table with a line for each of the 22 joints, for `--rig`.

    Args:
        clip: The clip; its motion is used to check that left is left.
        source: Its file, for the comment at the beginning.

    Raises:
        UserError: The figure has too many joints.
    """
    table = guess_table(clip)
    lines = [
        f"# Joints of HumanML3D and those of {source}: recognized by their names and by anatomy.",
        "# Check each line, then use --rig with this file.",
        f"# {_check(clip, table)}",
    ]
    for joint in HUMANML3D.joint_names:
        if joint in table:
            lines.append(f"{joint}: {_quoted(table[joint])}")
        else:
            needed = "may be missing" if joint in OPTIONAL_JOINTS else "NEEDED, none was recognized"
            lines.append(f"# {joint}:  # {needed}")
    names = clip.with_end_sites().joint_names
    # A person who corrects a line needs to know what else there is.
    unused = [name for name in names if name not in table.values() and not name.endswith("End Site")]
    return "\n".join([*lines, f"# Other joints of the file: {printable(', '.join(unused))}"]) + "\n"


def _quoted(name: str) -> str:
    """Returns a name as YAML between quotes, with escapes where it needs them."""
    return yaml.safe_dump(name, default_style='"', allow_unicode=True, width=math.inf).strip()


def _check(clip: RigClip, table: dict[str, str]) -> str:
    """Returns a sentence about left and right, and whether the clip is read without a table."""
    try:
        # Y up, so that a figure that lies is not refused: sides do not depend on it.
        right = float(left_is_left(retarget(clip, rig=table, up="y").positions).mean())
    except UserError as error:
        return f"Left and right were not checked: {error}"
    try:
        find_rig(clip, None)
    except UserError as error:
        return f"NOT READ WITHOUT THIS TABLE: {error}"
    if right > 0.5:
        return f"Left is left in {right:.0%} of the frames, as the knees bend and the feet point."
    return f"LEFT AND RIGHT ARE EXCHANGED in {1 - right:.0%} of the frames, as the knees bend and the feet point."
