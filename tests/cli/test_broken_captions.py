"""A data set with every fault that a caption can have: audit, training of an evaluator, and evaluation of a model."""

import dataclasses
import json

import numpy as np
import pytest

from t2m_jax.checkpoints.evaluator import load_trained_evaluator
from t2m_jax.cli.main import main
from t2m_jax.config import save_config
from t2m_jax.data.banks.captions import caption_tokens
from t2m_jax.data.folder import open_dataset
from t2m_jax.data.importers.synthetic import write_synthetic_dataset
from t2m_jax.data.texts import load_captions
from t2m_jax.evaluation.embedding import embed_captions
from t2m_jax.evaluation.protocols import find_protocol, make_plan
from t2m_jax.evaluation.report.record import load_report
from t2m_jax.evaluation.task import load_samples
from t2m_jax.files.manifest import MANIFEST
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from tests.tiny import EVALUATOR, LOOP

SOUND = "a person moves#a/DET person/NOUN move/VERB#0.0#0.0"
OTHER = "someone acts#someone/PRON act/VERB#0.0#0.0"
LONG = "a person walks " * 100
FAULTS = {
    "broken": f"{SOUND}\nno line of a caption at all\n",
    "empty": "#a/DET person/NOUN walk/VERB#0.0#0.0\n",
    "long": f"{LONG}#{'a/DET person/NOUN walk/VERB ' * 100}#0.0#0.0\n",
    "untagged": f"{LONG.upper()}##0.0#0.0\n",
    "unknown": "qux zorblax#qux/NOUN zorblax/VERB#0.0#0.0\n",
}
NUM_CLIPS = 24


class Faulty:
    """A data-set folder with one training clip for each fault."""

    def __init__(self, folder):
        write_synthetic_dataset(folder, num_clips=NUM_CLIPS, seed=5)
        self.folder = folder
        self.names = dict(zip(FAULTS, open_dataset(folder).names("train"), strict=False))
        for path in (folder / "texts").iterdir():
            path.write_text(f"{SOUND}\n{OTHER}\n", encoding="utf-8")
        (folder / MANIFEST).unlink()  # the faults are those of a folder that somebody wrote by hand
        for fault, text in FAULTS.items():
            self.file(fault).write_text(text, encoding="utf-8")

    def file(self, fault):
        return self.folder / "texts" / f"{self.names[fault]}.txt"


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    return Faulty(tmp_path_factory.mktemp("faulty") / "data")


@pytest.fixture(scope="module")
def evaluator_folder(faulty):
    run = faulty.folder.parent / "evaluator"
    config = TrainEvaluatorConfig(
        data=faulty.folder,
        run=run,
        model=EVALUATOR,
        decoder_hidden=8,
        movement_steps=2,
        movement_batch_size=4,
        loop=dataclasses.replace(LOOP, num_steps=2),
    )
    save_config(run.with_suffix(".yaml"), config)
    assert main(["train", "evaluator", f"{run.with_suffix('.yaml')}"]) == 0
    return run


@pytest.mark.slow
def test_the_audit_reports_each(faulty, tmp_path, capsys):
    assert main(["data", "check", f"{faulty.folder}", "--json", f"{tmp_path / 'report.json'}"]) == 1
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    broken, empty, untagged = report["problems"]
    assert broken.startswith(f"{faulty.file('broken')}:2: 1 fields separated by '#'")
    assert empty.startswith(f"{faulty.file('empty')}:1: the caption is empty")
    assert untagged.startswith(f"texts/{faulty.names['untagged']}.txt: caption 'A PERSON WALKS")
    assert untagged.endswith("...' has no word/POS tokens") and len(untagged) < 200
    silent, long, unknown = report["notes"]
    assert silent.startswith("1 clips have no caption that can be read") and faulty.names["empty"] in silent
    assert long.startswith("2 captions have more than 20 words") and faulty.names["long"] in long
    assert unknown.startswith("1 captions have no word") and faulty.names["unknown"] in unknown
    printed = capsys.readouterr().out
    for line in report["problems"] + report["notes"]:
        assert line in printed


@pytest.mark.slow
@pytest.mark.release
def test_an_evaluator_reads_what_can_be_read(faulty, evaluator_folder):
    evaluator = load_trained_evaluator(evaluator_folder)
    assert "walk" in evaluator.vocabulary and "qux" not in evaluator.vocabulary
    rows = np.genfromtxt(evaluator_folder / "train.csv", delimiter=",", names=True)
    assert np.isfinite(rows["loss"]).all()
    long, unknown = (load_captions(faulty.file(fault))[0].tokens for fault in ("long", "unknown"))

    def embed(*captions):
        return embed_captions(evaluator, captions)

    whole, first_20, first_19 = embed(long, long[:20], long[:19])
    np.testing.assert_array_equal(whole, first_20)
    assert np.abs(whole - first_19).max() > 1e-4, "fewer than twenty words are read"
    np.testing.assert_array_equal(*embed(unknown, ("unk/OTHER", "unk/OTHER")))
    untagged = caption_tokens(load_captions(faulty.file("untagged"))[0])
    np.testing.assert_array_equal(*embed(untagged, ("a", "person", "walks") * 7))


@pytest.mark.release
def test_an_evaluation_uses_all_captions_but_those_that_cannot_be_read(
    faulty, evaluator_folder, bundle_folder, tmp_path, caplog
):
    given = {"--model": bundle_folder, "--data": faulty.folder, "--evaluator": evaluator_folder, "--split": "train"}
    options = ["--protocol", "strict", "--num-repeats", "1", "--json", f"{tmp_path / 'report.json'}"]
    assert main(["evaluate", "generation", *(f"{word}" for pair in given.items() for word in pair), *options]) == 0
    assert "2 caption lines of train cannot be read and are left out" in caplog.text
    report = load_report(tmp_path / "report.json")
    dataset = open_dataset(faulty.folder)
    samples = load_samples(dataset, "train").clips
    counts = {sample.name: len(sample.captions) for sample in samples}
    names = faulty.names
    assert set(dataset.names("train")) - set(counts) == {names["empty"]}
    assert [counts[names[fault]] for fault in ("broken", "long", "untagged", "unknown")] == [1] * 4
    assert report.header.num_samples == len(counts)
    for name, metric in (*report.real.items(), *report.measured.items()):
        assert np.isfinite(metric.mean), name
    plan = make_plan(samples, find_protocol("strict"), seed=0, repeat=0, unit=report.header.unit)
    assert len(plan.samples) == sum(counts.values()), "not every caption counts once"
