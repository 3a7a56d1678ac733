import ast
import importlib
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import t2m_jax

PACKAGE = Path(t2m_jax.__file__).parent
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path.name != "__main__.py")
MODULES = [".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__") for path in FILES]
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in zip(MODULES, FILES, strict=True)}

HEAVY = ("jax", "jaxlib", "flax", "numpy", "orbax", "optax", "tyro", "tokenizers", "PIL")


def run_python(program: str) -> str:
    """Returns what a program of a fresh interpreter prints."""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def test_every_module_imports_and_says_what_it_is():
    assert [name for name in MODULES if not importlib.import_module(name).__doc__] == []


def test_every_folder_of_modules_is_a_package():
    assert [path for path in FILES if not (path.parent / "__init__.py").exists()] == []


def test_the_package_itself_imports_nothing():
    program = "import sys; before = set(sys.modules); import t2m_jax; print(*sorted(set(sys.modules) - before))"
    assert run_python(program) == "t2m_jax"


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["check", "--help"], ["no-such-command"]])
def test_help_and_refusals_import_nothing_heavy(arguments):
    program = f"""
import contextlib, io, sys
from t2m_jax.cli.main import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    main({arguments!r})
print(*[name for name in {HEAVY!r} if name in sys.modules])
"""
    assert run_python(program) == ""


def test_importing_everything_touches_no_device():
    program = f"""
import importlib
import jax
from jax._src import xla_bridge
for name in {MODULES!r}:
    importlib.import_module(name)
print(xla_bridge.backends_are_initialized())
"""
    assert run_python(program) == "False"


def longest_function(tree: ast.Module) -> tuple[int, str]:
    """Returns the lines of the longest function, docstring not counted, and its name."""
    lengths = [(0, "")]
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            docstring = node.body[0] if ast.get_docstring(node) else None
            lines = node.end_lineno - node.lineno + 1
            lengths.append((lines - (docstring.end_lineno - docstring.lineno + 1 if docstring else 0), node.name))
    return max(lengths)


def test_files_and_functions_stay_short_enough_to_read():
    assert [name for name, text in TEXTS.items() if len(text.splitlines()) > 340] == []
    longest = {name: longest_function(ast.parse(text)) for name, text in TEXTS.items()}
    assert {name: found for name, found in longest.items() if found[0] > 40} == {}


def test_no_two_classes_have_one_name():
    trees = [ast.parse(text) for text in TEXTS.values()]
    names = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert [name for name, count in names.items() if count > 1] == []


WRITERS = {
    "t2m_jax.checkpoints.official.export",
    "t2m_jax.data.cache",
    "t2m_jax.data.merge",
    "t2m_jax.data.writer",
    "t2m_jax.export.npz",
    "t2m_jax.export.onnx.convert",
    "t2m_jax.export.page.site",
    "t2m_jax.files.locks",
    "t2m_jax.files.writing",
    "t2m_jax.motion.character",
    "t2m_jax.motion.glb_file",
    "t2m_jax.motion.normalizer",
    "t2m_jax.serving.files",
    "t2m_jax.text.caption_states",
    "t2m_jax.train.code_cache",
    "t2m_jax.train.log",
}
"""Modules that open files to write. All do so inside of `atomic_file` or `atomic_folder`, but for rows of the log, the
owner in a lock, and what the server keeps in a temporary folder during a request."""
WRITES = re.compile(r"\.write_(text|bytes)\(|np\.save\w*\(|open\([^)]*[\"'][wax]b?\+?b?[\"']")


def test_files_are_written_in_one_way():
    assert {name for name, text in TEXTS.items() if WRITES.search(text.replace("open(os.devnull", ""))} == WRITERS


def test_texts_are_read_and_written_in_a_stated_encoding():
    for name, text in TEXTS.items():
        for node in ast.walk(ast.parse(text)):
            call = ast.unparse(node) if isinstance(node, ast.Call) else ""
            if re.fullmatch(r"(.*\.)?(open|fdopen|read_text|write_text)", call.partition("(")[0]):
                assert re.search(r"encoding=|'[rwax]\+?b\+?'|os\.open", call), f"{name}: {call}"
