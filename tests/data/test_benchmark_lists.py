"""The frozen tables of the benchmark: nothing leaks from one split to another, and nobody changes them by accident."""

import csv
import hashlib
import io
import itertools
from collections import defaultdict

import pytest

from t2m_jax.config import load_config
from t2m_jax.data.captioning.held_out import fingerprint, held_out_fingerprints
from t2m_jax.data.files import MIRROR_PREFIX, SPLITS
from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.caption_files import clip_name
from t2m_jax.evaluation.benchmark import TRACKS
from t2m_jax.motion.mirroring import mirror_caption
from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "configs" / "benchmark"


def read_table(path):
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


TABLES = {path.stem: read_table(path) for path in sorted(FOLDER.glob("*.csv"))}
NC = "bandai-namco"
REPOSITORY_OF_NC = "dataset/Bandai-Namco-Research-Motiondataset-{}/data/{}"
"""Where its files are, by the number of the data set and the name of the file."""


def rows(*, without=()):
    return [(name, row) for name, table in TABLES.items() if name not in without for row in table]


def said(row):
    return [row[column] for column in row if column.startswith("caption_") and row[column]]


def clips(table):
    """Returns split -> name of each clip and its captions, as an import makes them."""
    parts = defaultdict(list)
    for row in TABLES[table]:
        key = REPOSITORY_OF_NC.format(row["file"][8], row["file"]) if table == NC else row["file"]
        parts[key].append(row)
    for key, found in parts.items():
        found.sort(key=lambda row: (float(row["start"] or 0), float(row["end"] or 0)))
        for number, row in enumerate(found, start=1):
            yield row["split"], clip_name(key) + (f"_{number}" if len(found) > 1 else ""), said(row)


def digest(tables):
    lines = []
    for table in tables:
        for split, name, texts in clips(table):
            lines.append((split, name, texts))
            lines.append((split, MIRROR_PREFIX + name, [mirror_caption(text) for text in texts]))
    lines.sort(key=lambda line: (SPLITS.index(line[0]), line[1]))
    text = "".join("\n".join([split, name, *texts, ""]) for split, name, texts in lines)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def test_each_recording_is_in_one_split():
    splits, files = defaultdict(set), defaultdict(set)
    for name, row in rows():
        # By its bytes, so that a file under two names is found, too.
        splits[row["sha256"]].add(row["split"])
        files[row["sha256"]].add((name, row["file"]))
    assert {split for found in splits.values() for split in found} == set(SPLITS)
    assert [found for found in splits.values() if len(found) > 1] == []
    assert [found for found in files.values() if len(found) > 1] == []


def test_clips_of_one_recording_do_not_overlap():
    spans = defaultdict(list)
    for name, row in rows():
        spans[name, row["file"]].append((float(row["start"] or 0), float(row["end"] or "inf")))
    for place, found in spans.items():
        found.sort()
        # Borders were set by eye; half a second of both clips may be the same.
        assert all(one[1] <= other[0] + 0.5 for one, other in itertools.pairwise(found)), place


def test_people_of_the_test_split_who_are_in_no_other_one():
    people = defaultdict(set)
    for _, row in rows():
        assert row["person"] and row["action"]
        people[row["person"]].add(row["split"])
    assert {person for person, found in people.items() if found == {"test"}} >= {"Male1", "cmu-39"}


def test_models_of_the_package_were_not_trained_with_the_test_split():
    tested = {row["file"] for name, row in rows(without=(NC,)) if row["split"] == "test"}
    tables = [read_table(path) for path in (REPOSITORY / "configs" / "data").glob("*.csv")]
    assert not tested & {row["file"] for table in tables for row in table if row["split"] != "test"}


def test_captions_are_few_and_none_is_a_sentence_that_models_are_tested_with():
    held_out = held_out_fingerprints()
    for _, row in rows():
        assert said(row) and len(said(row)) == len(set(said(row)))
        assert not [text for text in said(row) if fingerprint(text) in held_out]
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 1_000_000


@pytest.mark.parametrize("track", TRACKS)
def test_the_tables_are_the_frozen_ones(track):
    assert digest([name for name in TABLES if track == "nc" or name != NC]) == TRACKS[track].lists


def script_imports():
    """Returns what the script imports: name of the table, folder below that of the archives, and information."""
    script = (FOLDER / "data.sh").read_text(encoding="utf-8").splitlines()
    return [line.split()[1:] for line in script if line.strip().startswith("import ")]


def test_the_script_imports_all_tables_with_licenses():
    assert {name for name, _, _ in script_imports()} == set(TABLES)
    for name, _, info in script_imports():
        found = load_config(REPOSITORY / "configs" / "data" / f"{info}.yaml", DatasetInfo)
        assert found.licence and ("NC" in found.licence) == (name == NC)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "folder"),
    [
        pytest.param(name, folder, marks=[pytest.mark.release] * (name != "cmu-misc"), id=name)
        for name, folder, _ in script_imports()
    ],
)
def test_every_row_of_a_table_gives_a_clip(name, folder, shared_data, tmp_path):
    archive, _, below = folder.partition("/")
    table = FOLDER / f"{name}.csv"
    # With `frozen`, a row without a clip is an error.
    report = import_bvh_folder(shared_data(archive) / below, tmp_path / "data", captions=table, frozen=True)
    assert report.num_frames > 0
