"""What users of the page read if something is wrong: the names of their files, and nothing to type in a terminal."""

import ast
import re
from pathlib import Path

import pytest

import t2m_jax
from t2m_jax.errors import UserError
from t2m_jax.motion.changes import Changes
from t2m_jax.serving.files import Names, open_file
from t2m_jax.serving.wording import IN_BROWSER, in_browser
from tests.export.conftest import walk  # noqa: F401 - a fixture
from tests.motion.rig.foreign import nameless  # noqa: F401 - a fixture
from tests.serving.test_files import data_of

PACKAGE = Path(t2m_jax.__file__).parent
COMMAND = re.compile(r"`t2m |pip install|(?<![\w-])--[a-z]")
NOT_SERVED = ("replay.py", "convert.py")
BROKEN_BVH = "HIERARCHY\nROOT Hips\n{\n  OFFSET x 0 0\n}\n"


def messages(path: Path) -> list[str]:
    """Returns the texts of a module but for docstrings and the comments of files that it writes."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    documented = [node for node in ast.walk(tree) if isinstance(node, ast.Expr)]
    docstrings = {id(node.value) for node in documented}
    texts = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in docstrings]
    return [node.value for node in texts if isinstance(node.value, str) and not node.value.startswith("#")]


def test_no_message_of_what_is_served_has_a_command():
    files = [file for part in ("motion", "export", "sampling", "text") for file in (PACKAGE / part).rglob("*.py")]
    said = [text for file in files if file.name not in NOT_SERVED for text in messages(file) if COMMAND.search(text)]
    assert [text for text in said if COMMAND.search(in_browser(UserError(text)))] == []
    assert [command for command in IN_BROWSER if not any(command in text for text in said)] == []


def test_errors_name_the_files_of_the_user(nameless, walk):  # noqa: F811
    names = Names("my walk.bvh", "joints.yaml")
    with pytest.raises(UserError, match=r'^my walk\.bvh:4: OFFSET of "Hips"'):
        open_file(BROKEN_BVH.encode(), "bvh", Changes(), None, names)
    with pytest.raises(UserError, match=r"^joints\.yaml: "):
        open_file(nameless.read_bytes(), "bvh", Changes(), "foo: 1", names)
    slow = data_of(type(walk)(walk.positions, 0.01))
    with pytest.raises(UserError, match=r"^my walk\.bvh: has .* seconds; at most 600"):
        open_file(slow, "npz", Changes(), None, names)
