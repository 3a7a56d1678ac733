"""Going on with a run: as if it had never stopped, and only with the config it was started with."""

import contextlib
import csv
import dataclasses
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints import load_model, load_tokenizer
from t2m_jax.checkpoints.audit import audit_model
from t2m_jax.checkpoints.tokenizer import save_tokenizer_copy
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.train import train
from tests.tiny import LOOP, gpt_training, vqvae_training
from tests.train.conftest import assert_same_checkpoint, newest_checkpoint, read_checkpoint, stop_at

STAGES = ["vqvae", pytest.param("gpt", marks=pytest.mark.slow)]
STOP = 7
"""The update that never ends; the newest checkpoint is then that of step 4, and rows past it were written."""


class Stage:
    """One of the two trainings, into a folder of its own."""

    def __init__(self, name, runs, run):
        self.finished = {"vqvae": runs.vqvae, "gpt": runs.gpt}[name]
        # The config of a run to resume has to name the VQ-VAE by which it was started.
        self.config = vqvae_training(runs.data, run) if name == "vqvae" else gpt_training(runs.data, runs.vqvae, run)

    def train(self, *, resume=False, **loop):
        config = dataclasses.replace(self.config, loop=dataclasses.replace(self.config.loop, **loop))
        return train(config, resume=resume)


@pytest.fixture
def stage(request, runs, tmp_path):
    return Stage(request.param, runs, tmp_path / "run")


def texts(run):
    return {name: (run / name).read_bytes() for name in ("train.csv", "val.csv")}


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES, indirect=True)
def test_a_resumed_run_equals_one_that_never_stopped(stage, monkeypatch):
    mend = stop_at(STOP, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        stage.train()
    run = stage.config.run
    assert newest_checkpoint(run)[0] == 4
    with (run / "train.csv").open(encoding="utf-8") as file:
        assert [row["step"] for row in csv.DictReader(file)] == ["3", "4", "6"]
    mend()
    state = stage.train(resume=True)
    assert int(state.step) == LOOP.num_steps
    assert texts(run) == texts(stage.finished)
    assert_same_checkpoint(run, stage.finished)


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize("stage", STAGES, indirect=True)
def test_calls_of_several_updates_are_resumed_exactly_too(stage, tmp_path):
    """The whole run has calls of 3, 1, 3 and 1 updates; that of the other from step 4 is cut short."""
    loop = {"steps_per_call": 3, "log_every": 100}
    stage.train(**loop)
    whole = stage.config.run
    stage.config = dataclasses.replace(stage.config, run=tmp_path / "again")
    stage.train(num_steps=6, **loop)
    stage.train(resume=True, **loop)
    assert_same_checkpoint(stage.config.run, whole)


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES, indirect=True)
def test_a_run_that_stopped_before_its_first_checkpoint_starts_over(stage, monkeypatch):
    mend = stop_at(4, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        stage.train()
    assert (stage.config.run / "train.csv").exists()
    mend()
    stage.train(resume=True)
    assert texts(stage.config.run) == texts(stage.finished)
    assert_same_checkpoint(stage.config.run, stage.finished)


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES, indirect=True)
def test_a_run_may_be_prolonged_and_a_finished_one_is_left_alone(stage):
    run = stage.config.run
    stage.train(num_steps=4)
    before = {path: path.stat().st_mtime_ns for path in (run / "checkpoints").rglob("*")}
    written = texts(run)
    state = stage.train(resume=True, num_steps=4)
    assert int(state.step) == 4
    assert texts(run) == written
    assert {path: path.stat().st_mtime_ns for path in (run / "checkpoints").rglob("*")} == before
    stage.train(resume=True)
    assert texts(run) == texts(stage.finished)
    assert_same_checkpoint(run, stage.finished)


def test_the_step_counts(runs, tmp_path):
    """What the equalities above could not see: that steps differ and that training moves every part."""
    early, late = (read_checkpoint(runs.vqvae, step) for step in (4, 8))
    assert (early["step"]["step"], late["step"]["step"]) == (4, 8)
    for part in ("params", "codebook", "opt_state"):
        same = jax.tree.map(np.array_equal, early[part], late[part])
        assert not all(jax.tree.leaves(same))
    for part in ("encoder", "decoder"):
        same = jax.tree.map(np.array_equal, early["params"]["params"][part], late["params"]["params"][part])
        assert not any(jax.tree.leaves(same)), part


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES, indirect=True)
def test_data_that_only_moved_are_accepted(stage, runs, tmp_path):
    stage.train(num_steps=4)
    shutil.copytree(runs.data, tmp_path / "moved")
    fields = {"data": tmp_path / "moved"}
    if hasattr(stage.config, "vqvae"):
        fields["vqvae"] = shutil.copytree(runs.vqvae, tmp_path / "tokenizer")
    stage.config = dataclasses.replace(stage.config, **fields)
    stage.train(resume=True)
    assert_same_checkpoint(stage.config.run, stage.finished)


def add_to_first_frame(data):
    path = min((data / "new_joint_vecs").iterdir())
    features = np.load(path)
    features[0, 0] += 0.01
    np.save(path, features)


def scale_statistics(data):
    np.save(data / "Mean.npy", 1.001 * np.load(data / "Mean.npy"))


def drop_a_clip(data):
    names = (data / "train.txt").read_text().split()
    (data / "train.txt").write_text("\n".join(names[1:]))


def add_a_caption(data):
    with min((data / "texts").iterdir()).open("a") as file:
        file.write("a person stands#a/DET person/NOUN stands/VERB#0.0#0.0\n")


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES, indirect=True)
@pytest.mark.parametrize(
    ("change", "named"),
    [
        (add_to_first_frame, "clips and captions"),
        (scale_statistics, "statistics"),
        (drop_a_clip, "splits"),
        (add_a_caption, "clips and captions"),
    ],
)
def test_data_that_changed_are_refused(stage, runs, tmp_path, change, named):
    stage.config = dataclasses.replace(stage.config, data=shutil.copytree(runs.data, tmp_path / "data"))
    stage.train(num_steps=4)
    change(tmp_path / "data")
    before = {path: path.read_bytes() for path in stage.config.run.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match=rf"data: .* is not what .* was started with \(changed: {named}\)"):
        stage.train(resume=True)
    assert {path: path.read_bytes() for path in stage.config.run.rglob("*") if path.is_file()} == before


@pytest.mark.slow
@pytest.mark.parametrize("balance", [0.0, 0.5])
@pytest.mark.parametrize("stage", ["gpt"], indirect=True)
def test_labels_may_change_unless_they_decide_draws(stage, runs, tmp_path, balance, monkeypatch):
    data = Path(shutil.copytree(runs.data, tmp_path / "data"))
    stage.config = dataclasses.replace(stage.config, data=data, balance=balance)
    # A run that has begun is enough: to compile its update takes longest.
    mend = stop_at(1, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        stage.train()
    mend()
    index = (data / "index.csv").read_text()
    (data / "index.csv").write_text(index.replace("walk", "run", 2))
    stays = contextlib.nullcontext()
    refused = pytest.raises(UserError, match=r"\(changed: labels that decide draws\)")
    with refused if balance else stays:
        stage.train(num_steps=4, resume=True)


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["vqvae"], indirect=True)
def test_weights_and_statistics_of_the_start_may_move_but_not_change(stage, runs, tmp_path):
    def copied(source, name):
        return shutil.copytree(source, tmp_path / name)

    def resume(**fields):
        stage.config = dataclasses.replace(start, **fields)
        stage.train(resume=True)

    statistics = copied(runs.data, "statistics")
    scale_statistics(statistics)
    stage.config = dataclasses.replace(stage.config, init=copied(runs.vqvae, "init"), statistics=f"{statistics}")
    start = stage.config
    stage.train(num_steps=4)
    other = copied(stage.config.run, "other")  # the same tokenizer, with other weights
    for fields, said in (({"init": other}, "with init "), ({"statistics": f"{runs.data}"}, "with statistics ")):
        with pytest.raises(UserError, match=said):
            resume(**fields)
    moved = {"init": copied(runs.vqvae, "init-2"), "statistics": f"{copied(statistics, 'statistics-2')}"}
    resume(**moved)


@pytest.mark.parametrize("stage", ["vqvae"], indirect=True)
def test_a_seed_that_was_edited_in_a_run_is_not_taken(stage, capsys):
    run = shutil.copytree(stage.finished, stage.config.run)
    path = run / "config.yaml"
    path.write_text(path.read_text().replace("seed: 0", "seed: 1"))
    assert main(["train", "vqvae", "--run", f"{run}", "--resume"]) == 2
    assert "config.yaml: has changed since it was written" in capsys.readouterr().err


@pytest.mark.parametrize("stage", STAGES, indirect=True)
def test_a_damaged_file_of_the_start_is_found_wherever_a_run_is_read(stage):
    shutil.copytree(stage.finished, stage.config.run)
    (stage.config.run / "notes.txt").write_text("the user's own")
    names = {path.name for path in stage.config.run.iterdir() if path.suffix in (".npy", ".yaml", ".json")}
    names -= {"config.yaml", "run.yaml"}
    assert {"vqvae": {"Mean.npy", "vqvae.yaml"}, "gpt": {"bundle.yaml", "tokenizer.json"}}[stage.config.kind] < names
    load = {"vqvae": load_tokenizer, "gpt": load_model}[stage.config.kind]
    for name in names:
        whole = (stage.config.run / name).read_bytes()
        (stage.config.run / name).write_bytes(whole[:-3] + bytes([whole[-3] ^ 1]) + whole[-2:])
        for read in (load, lambda run: stage.train(resume=True, num_steps=20)):
            with pytest.raises(UserError, match=rf"{name}: has changed since it was written"):
                read(stage.config.run)
        assert [part.problem for part in audit_model(stage.config.run) if name in part.problem]
        (stage.config.run / name).write_bytes(whole)
    load(stage.config.run)


@pytest.mark.parametrize("stage", ["gpt"], indirect=True)
def test_a_run_knows_the_copy_of_its_tokenizer(stage, runs):
    run = shutil.copytree(stage.finished, stage.config.run)
    tokenizer = load_tokenizer(run)
    other = jax.tree.map(lambda leaf: 2 * leaf, tokenizer.variables["params"])
    shutil.rmtree(run / "vqvae")
    save_tokenizer_copy(run, tokenizer._replace(variables=tokenizer.variables | {"params": other}))
    for read in (load_model, load_tokenizer, lambda _: stage.train(resume=True, num_steps=20)):
        with pytest.raises(UserError, match=r"vqvae/manifest\.txt: has changed since it was written"):
            read(run)
    assert "vqvae/manifest.txt" in "".join(part.problem for part in audit_model(run))


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("vqvae", {"window": 16}, "window 32, not 16"),
        ("vqvae", {"loop.seed": 6}, "loop.seed 5, not 6"),
        ("vqvae", {"loop.batch_size": 5}, "loop.batch_size 4, not 5"),
        ("vqvae", {"optimizer.learning_rate": 0.5}, "optimizer.learning_rate 0.001, not 0.5"),
        ("vqvae", {"model.width": 8}, "model.width 16, not 8"),
        ("gpt", {"model.num_layers": 1}, "model.num_layers 2, not 1"),
        ("gpt", {"tau": 0.9}, "tau 0.5, not 0.9"),
        ("gpt", {"caption_encoder.dropout": 0.0}, "caption_encoder.dropout 0.1, not 0.0"),
    ],
)
def test_another_config_is_refused_with_the_field_named(runs, tmp_path, name, change, says):
    stage = Stage(name, runs, runs.vqvae if name == "vqvae" else runs.gpt)
    config = stage.config
    if name == "gpt":
        config = dataclasses.replace(config, vqvae=runs.data.parent / "first")
    for field, value in change.items():
        section, _, field = field.rpartition(".")
        part = dataclasses.replace(getattr(config, section) if section else config, **{field: value})
        config = dataclasses.replace(config, **{section: part}) if section else part
    with pytest.raises(UserError) as caught:
        train(config, resume=True)
    assert says in str(caught.value)
    assert str(config.run) in str(caught.value)


@pytest.mark.parametrize("stage", STAGES, indirect=True)
def test_a_run_is_neither_written_over_nor_made_up(stage):
    with pytest.raises(UserError, match="not a run directory"):
        stage.train(resume=True)
    assert not stage.config.run.exists()
    stage.config = dataclasses.replace(stage.config, run=stage.finished)
    before = texts(stage.finished)
    with pytest.raises(UserError, match="--resume"):
        stage.train()
    assert texts(stage.finished) == before
