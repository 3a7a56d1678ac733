"""Every config in `configs/` loads, and every command its header names is one that works."""

import re
import shlex
import subprocess

import pytest

from t2m_jax.cli.train import _config
from t2m_jax.config import load_config, override_config
from t2m_jax.data.captioning.wordings import load_wordings
from t2m_jax.data.files import SPLITS
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.importers.caption_table import load_caption_table
from t2m_jax.train.shipped import find_config, shipped_configs
from tests.conftest import REPOSITORY

DATA = REPOSITORY / "configs" / "data"
CONFIGS = sorted(path for path in (REPOSITORY / "configs").rglob("*.yaml") if path.parent != DATA)
PAIRS = [
    (REPOSITORY / "configs" / folder, tokenizer, generator)
    for folder, tokenizer, generator in (
        ("t2m-gpt", "vqvae", "gpt"),
        ("synthetic", "vqvae", "gpt"),
        ("hifigpt", "rvqvae", "hifigpt"),
    )
]


def commands(path):
    """Returns stage, config and options of each training command in a file's header."""
    header = path.read_text(encoding="utf-8").partition("\ndata:")[0]
    return [
        (stage, name, shlex.split(rest))
        for stage, name, rest in re.findall(r"t2m train (\w+) ([^\s`]+)([^`\n]*)", header)
    ]


def config_of(stage, name, options):
    return override_config(_config(stage, name), options, prog="t2m train")


def test_the_planned_trainings_of_the_claims_can_be_started():
    script = REPOSITORY / "configs" / "claims" / "claims.sh"
    printed = subprocess.run(["sh", f"{script}"], capture_output=True, text=True, check=True).stdout.splitlines()
    runs = {}
    for kind, name, *options in (line.split()[2:] for line in printed if line.startswith("t2m train")):
        config = config_of(kind, f"configs/{name}.yaml", options)
        assert config.run not in runs and getattr(config, "vqvae", config.run) in {*runs, config.run}
        runs[config.run] = config.loop.seed
    assert set(runs.values()) == {0, 1, 2}
    measured = {
        words[words.index("benchmark") + 1] for line in printed if "t2m benchmark" in line for words in [line.split()]
    }
    measured |= {line.split()[4] for line in printed if "evaluate reconstruction" in line}
    assert measured == {f"{run}" for run in runs}


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_the_commands_of_a_header_work(path, monkeypatch):
    monkeypatch.chdir(REPOSITORY)
    found = commands(path)
    own = [(stage, options) for stage, name, options in found if name == f"{path.relative_to(REPOSITORY)}"]
    assert own, "the header does not say how to use the file"
    configs = [config_of(stage, name, options) for stage, name, options in found]
    assert all(config.run.is_relative_to("runs") for config in configs)
    if path.parent.name == "ablations":
        assert len(own) > 2
        assert len({config.run for config in configs[: len(own)]}) == len(own), "two rows would share a run"
        assert config_of(own[0][0], str(path), []) in configs, "no row is the file as it stands"


@pytest.mark.parametrize(("folder", "tokenizer", "generator"), PAIRS, ids=[pair[0].name for pair in PAIRS])
def test_the_stages_of_a_folder_fit(folder, tokenizer, generator):
    first, second = (config_of(name, str(folder / f"{name}.yaml"), []) for name in (tokenizer, generator))
    assert second.vqvae == first.run
    assert second.data == first.data
    for name in ("num_codes", "num_quantizers"):
        assert getattr(second.model, name) == getattr(first.model, name)


@pytest.mark.parametrize(
    ("model", "motion", "composed"),
    [("demo", "all", "demo"), ("demo-free", "all-free", "demo-free"), ("demo-t2m-gpt", "all", "demo")],
)
def test_the_script_of_the_packaged_models_fits_their_configs(model, motion, composed):
    # The script with `echo` in front of what it would do.
    script = (REPOSITORY / "configs" / "demo" / "make.sh").read_text(encoding="utf-8")
    script = re.sub("^(t2m|sh|rm) ", r"echo \1 ", script, flags=re.MULTILINE)
    printed = subprocess.run(["sh", "-s", "archives", model], input=script, capture_output=True, text=True, check=True)
    *trainings, teaching = (line.split()[1:] for line in printed.stdout.splitlines() if line.startswith("t2m "))
    tokenizer, generator = (config_of(kind, str(REPOSITORY / path), options) for _, kind, path, *options in trainings)
    assert (f"{tokenizer.data}", f"{generator.data}") == (f"data/{motion}", f"data/{composed}")
    assert generator.vqvae == tokenizer.run
    for name in ("num_codes", "num_quantizers"):
        assert getattr(generator.model, name) == getattr(tokenizer.model, name)
    card = f"configs/{model}/card.md"
    sentences = f"{DATA.relative_to(REPOSITORY)}/sentences.yaml"
    destination = f"t2m_jax/bundles/{model}"
    data = f"{generator.data}"
    assert teaching == ["teach", f"{generator.run}", sentences, destination, "--data", data, "--card", card]
    assert (REPOSITORY / sentences).is_file() and (REPOSITORY / card).is_file()


@pytest.mark.parametrize("path", sorted(DATA.glob("*.csv")), ids=lambda path: path.stem)
def test_the_tables_of_the_archives_can_be_read(path):
    table = load_caption_table(path)
    rows = [row for same in table.entries.values() for row in same]
    assert not [row.problem for row in rows if row.problem] and not table.notes
    assert {"action", "person", "split"} <= set(table.columns)
    known = load_wordings().contents
    for row in rows:
        assert row.cells["split"] in SPLITS and row.cells["person"], row.place
        assert row.captions or row.cells["action"] in known, f"{row.place}: a clip without words"
    # Clips of one recording are alike.
    files = {row.file: {other.cells["split"] for other in rows if other.file == row.file} for row in rows}
    assert not [file for file, homes in files.items() if len(homes) > 1]


def test_the_data_of_the_models_have_licenses():
    script = (REPOSITORY / "configs" / "demo" / "data.sh").read_text(encoding="utf-8")
    imports = re.findall(r"^import (\S+) \S+ (\S+)$", script, re.MULTILINE)
    assert {name for name, _ in imports} == {path.stem for path in DATA.glob("*.csv")}
    for _, info in imports:
        found = load_config(DATA / f"{info}.yaml", DatasetInfo)
        assert found.licence and found.source and "Changed: resampled" in found.attribution
    (free,) = re.findall(r'^free="(.*)"$', script, re.MULTILINE)
    assert "berkeley" not in free and "bandai" not in free


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_configs_are_found_by_name_from_everywhere(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = f"{path.parent.name}/{path.stem}"
    shipped = shipped_configs()[name]
    assert shipped.path == path and shipped.summary and len(shipped.summary) < 250
    assert find_config(shipped.kind, name) == find_config(shipped.kind, f"configs/{name}.yaml") == path
    assert _config(shipped.kind, name) == config_of(shipped.kind, str(path), [])
