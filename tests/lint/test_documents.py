"""What the pages say is there: links lead somewhere, and `t2m` accepts each command (test_wheel.py runs them)."""

import functools
import importlib
import itertools
import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
import yaml
from markdown_it import MarkdownIt
from mdit_py_plugins.anchors import anchors_plugin

from t2m_jax.cli.main import COMMANDS, main
from t2m_jax.cli.train import _start_config
from t2m_jax.config import override_config
from t2m_jax.train.experiment import find_trainer
from tests.conftest import REPOSITORY
from tests.documents import PAGES, code_blocks, commands, name_of

LINKING = [*PAGES, *sorted((REPOSITORY / "docs" / "api").glob("*.md"))]
LINKING += [path for path in sorted(REPOSITORY.glob("*.md")) if path not in PAGES]


@functools.cache
def attributes(page: Path, name: str) -> set[str]:
    """Returns the values of an attribute (`href`, `src`, `id`) of all elements of a page."""
    parser = MarkdownIt("commonmark").enable("table").use(anchors_plugin, max_level=4)
    tokens = parser.parse(page.read_text(encoding="utf-8"))
    elements = itertools.chain(tokens, *(token.children or () for token in tokens))
    return {str(token.attrs[name]) for token in elements if name in token.attrs}


def test_each_promise_names_a_test_that_exists():
    text = (REPOSITORY / "SECURITY.md").read_text(encoding="utf-8")
    promises = [line for line in text.splitlines() if line.startswith("| **")]
    assert len(promises) > 12
    for promise in promises:
        shown_by = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", promise)
        assert shown_by, promise
        for file, test in shown_by:
            assert f"\ndef {test}(" in (REPOSITORY / file).read_text(encoding="utf-8"), f"{file}::{test}"


@pytest.mark.parametrize("target", ["demo", "test", "docs", "notebooks"])
def test_make_says_what_takes_minutes_before_it_begins(target, tmp_path):
    makefile = REPOSITORY / "Makefile"
    asked = [
        "make",
        "--dry-run",
        "-f",
        f"{makefile}",
        "-C",
        f"{REPOSITORY}",
        f"VENV={tmp_path}",
        f"BIN={tmp_path}",
        target,
    ]
    lines = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.splitlines()
    number = next(number for number, line in enumerate(lines) if " pip install " in line)
    assert re.match('echo "Installing .*: a minute or two."', lines[number - 1])


@pytest.mark.parametrize("command", ["make demo", "make test"])
def test_the_readme_says_how_long_its_first_commands_take(command):
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    (said,) = re.findall(rf"^{command} .*#(.*)$", readme, re.MULTILINE)
    assert "minute" in said


@pytest.mark.parametrize("page", LINKING, ids=name_of)
def test_links_lead_somewhere(page):
    broken = []
    for link in attributes(page, "href") | attributes(page, "src"):
        place, _, anchor = unquote(link).partition("#")
        target = page.parent / place if place else page
        if re.match(r"https?:", link):
            continue
        if not target.exists() or (anchor and anchor not in attributes(target.resolve(), "id")):
            broken.append(link)
    assert broken == []


def check_config(args):
    """Reads the config and the options of a training instead of training."""
    if args.diff is None:
        start = find_trainer(args.kind).config() if args.resume else _start_config(args)
        override_config(start, args.config_options, prog=f"t2m train {args.kind}")


# Kinds of systems.md come from a package that is not installed; tests/third_system runs its commands.
@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "systems.md"], ids=name_of)
def test_commands_and_their_options_exist(page, monkeypatch, capsys):
    monkeypatch.chdir(REPOSITORY)
    for name in COMMANDS:
        monkeypatch.setattr(importlib.import_module(f"t2m_jax.cli.{name}"), "run", lambda args: None)
    monkeypatch.setattr("t2m_jax.cli.train.run", check_config)
    text = "".join(block for _, block in code_blocks(page, "sh"))
    for command in commands(text):
        arguments = shlex.split(command.partition("t2m ")[2].removesuffix("&").replace("$i", "0"))
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"


@pytest.mark.slow
@pytest.mark.release
def test_the_recipe_for_nnx_gives_what_the_linen_modules_give():
    page = (REPOSITORY / "docs" / "systems.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", page.partition("\n## Use the modules from NNX\n")[2], re.DOTALL):
        exec(block, names)  # noqa: S102 - the page's code is run as it is
    model, motion, text, codes = (names[name] for name in ("model", "motion", "text", "codes"))
    tokenizer = functools.partial(names["VqVae"](model.config.tokenizer).apply, model.variables["tokenizer"])
    gpt = functools.partial(names["MotionGpt"](model.config.generator).apply, model.variables["generator"])
    np.testing.assert_array_equal(codes, tokenizer(motion, method="encode"))
    np.testing.assert_allclose(names["decoded"], tokenizer(codes, method="decode"), atol=1e-5)
    np.testing.assert_allclose(names["logits"], gpt(codes[:, :, 0], text, train=False), atol=1e-5)
    assert names["losses"][-1] < names["losses"][0]
    assert np.abs(names["gpt"](codes[:, :, 0], text, train=False) - names["logits"]).max() > 1e-3
    keys = {"codebook": names["nnx"].Rngs(codebook=0).codebook()}
    moved = tokenizer(motion, train=True, mutable=["codebook"], rngs=keys)[1]["codebook"]["quantizer"]["codebook"]
    np.testing.assert_allclose(names["codebook"][...], moved, atol=1e-5)
    assert np.abs(moved - model.variables["tokenizer"]["codebook"]["quantizer"]["codebook"]).max() > 1e-3


def test_the_citation_has_what_its_format_requires():
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["cff-version"] == "1.2.0"
    assert citation["license"] == project["license"]
    assert citation["type"] == "software"
    assert citation["message"]
    for work in (citation, *citation["references"]):
        assert work["title"]
        assert all("name" in author or {"family-names", "given-names"} == set(author) for author in work["authors"])
