"""The public names are few, the pages of the Python interface list exactly them, and other pages import no others."""

import ast
import importlib
import inspect
import json
import re
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY
from tests.documents import PAGES, code_blocks

INTERFACE = REPOSITORY / "docs" / "api"
NOTEBOOKS = sorted((REPOSITORY / "notebooks").glob("*.ipynb"))
MAX_NAMES = 130


def public_names(face: Path) -> list[str]:
    """Returns the list `__all__` of a package, empty without one."""
    for node in ast.parse(face.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


PACKAGES = {
    ".".join(path.parent.relative_to(REPOSITORY).parts): public_names(path)
    for path in sorted((REPOSITORY / "t2m_jax").rglob("__init__.py"))
}
FACES = {name: names for name, names in PACKAGES.items() if names}


def listed_names(face: str) -> list[str]:
    """Returns the names in the first columns of the tables about a package, in the pages of the Python interface."""
    page = INTERFACE / f"{(face + '.').split('.')[1] or face}.md"
    sections = dict(re.findall(r"^#+ `([\w.]+)`\n(.*?)(?=^#+ |\Z)", page.read_text(encoding="utf-8"), re.DOTALL | re.M))
    cells = re.findall(r"^\| (`.*?) \|", sections[face], re.MULTILINE)
    return [name for cell in cells for name in re.findall(r"`(\w+)`", cell)]


def imports_of(page: Path) -> list[tuple[str, str]]:
    """Returns the packages and names of the `from` imports in the Python code of a page or a notebook."""
    if page.suffix == ".ipynb":
        cells = json.loads(page.read_text(encoding="utf-8"))["cells"]
        blocks = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    else:
        blocks = [text for _, text in code_blocks(page, "python")]
    nodes = [node for block in blocks for node in ast.walk(ast.parse(block)) if isinstance(node, ast.ImportFrom)]
    return [(node.module or "", alias.name) for node in nodes for alias in node.names]


def public_functions(face: str) -> list:
    """Returns the public functions of a package, and the methods of its public classes."""
    found = [getattr(importlib.import_module(face), name) for name in FACES[face]]
    classes = [value for value in found if inspect.isclass(value)]
    methods = [getattr(kind, name) for kind in classes for name in vars(kind) if not name.startswith("_")]
    return [value for value in (*found, *methods) if inspect.isfunction(value) or inspect.ismethod(value)]


@pytest.mark.parametrize("face", FACES)
def test_what_takes_a_path_takes_it_as_text_too(face):
    """What a function does with a text, mypy checks."""
    kinds = [(f.__qualname__, kind) for f in public_functions(face) for kind in inspect.get_annotations(f).items()]
    paths = [(name, kind) for name, kind in kinds if "Path" in str(kind[1]) and kind[0] != "return"]
    assert [name for name, kind in paths if "str" not in str(kind[1])] == []


def test_public_names_are_few():
    assert sum(map(len, FACES.values())) <= MAX_NAMES


def test_a_name_is_public_in_one_package_only():
    """`t2m_jax.Motion` is a short way, and there are two kinds of reports."""
    names = [name for names in FACES.values() for name in names]
    assert sorted(name for name in set(names) if names.count(name) > 1) == ["Motion", "load_report", "save_report"]


@pytest.mark.parametrize("face", FACES)
def test_the_interface_lists_exactly_the_public_names(face):
    assert sorted(listed_names(face)) == sorted(FACES[face])


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS], ids=lambda path: path.stem)
def test_pages_import_public_names(page):
    hidden = [(face, name) for face, name in imports_of(page) if name not in PACKAGES.get(face, [name])]
    assert [pair for pair in hidden if ".".join(pair) not in PACKAGES] == []
