"""Tables of captions as people write them: each row gives its caption or is reported."""

import numpy as np
import pytest

from t2m_jax.data.importers.bvh import import_bvh_folder
from t2m_jax.data.importers.caption_table import find_entries, load_caption_table
from t2m_jax.errors import UserError
from tests.data.bvh_files import write_bvh
from tests.data.test_bvh_folder import all_captions, write_clips

WALK, TURN = "a man walks", "he walks, then turns, and stops"


def read(tmp_path, text, *, name="captions.csv", keys=("a", "b")):
    """Returns what each of the motions a and b is said to do, the problems of all rows, and the notes."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    table = load_caption_table(path, keys=keys)
    said = {key: [c.text for row in find_entries(table, (key,)) for c in row.captions] for key in ("a", "b")}
    problems = [row.problem for rows in table.entries.values() for row in rows if row.problem]
    return said, problems, table.notes


@pytest.mark.parametrize(
    "text",
    [
        f"file,caption\na,{WALK}\nb,{TURN}\n",
        f'file,caption\na,{WALK}\nb,"{TURN}"\n',
        f"file;caption\na;{WALK}\nb;{TURN}\n",
        f"file\tcaption\na\t{WALK}\nb\t{TURN}\n",
        f"file|caption\r\na|{WALK}\r\nb|{TURN}\r\n",
        f"Clip Name,Description\na.bvh,{WALK}\nb.BVH,{TURN}\n",
        f"caption,file\n{WALK},a\n{TURN},b\n",
        f"id,text,start,end\na,{WALK},,\nb,{TURN},,\n",
        f"id,text,start,end\na,{WALK}\nb,{TURN}\n",
        f"file,caption,actor\na,{WALK},Ann\nb,{TURN},Bob\n",
        f"a,{WALK}\nb,{TURN}\n",
        f"\n\nfile,what is said: text\n\na,{WALK}\n\nb,{TURN}\n\n",
        f"path,caption\n/home/ann/mocap/a.fbx,{WALK}\n.\\b.bvh,{TURN}\n",
        f"FILE,CAPTION\nA,{WALK}\nB,{TURN}\n",
    ],
)
def test_many_forms_of_one_table_give_the_same_captions(tmp_path, text):
    said, problems, _ = read(tmp_path, text)
    assert said == {"a": [WALK], "b": [TURN]} and not problems


@pytest.mark.parametrize("name", ["captions.tsv", "captions.txt"])
def test_tables_with_tabs_may_have_other_names(tmp_path, name):
    for header in ("file\tcaption\tstart\tend\n", ""):
        said, problems, _ = read(tmp_path, f"{header}a\t{WALK}\t0.5\t1.0\nb\t{TURN}\t\t\n", name=name)
        assert said == {"a": [WALK], "b": [TURN]} and not problems
        table = load_caption_table(tmp_path / name, keys=("a", "b"))
        assert find_entries(table, ("a",))[0].span == (0.5, 1.0)
    said, problems, _ = read(tmp_path, f"a\t{WALK}\nb: {TURN}\n", name="captions.txt")
    assert said == {"a": [WALK], "b": [TURN]} and not problems


def test_times_may_be_written_in_camel_case(tmp_path):
    path = tmp_path / "captions.csv"
    path.write_text(f"fileName,caption,startTime,endTime\na,{WALK},0.5,1.0\n")
    assert find_entries(load_caption_table(path, keys=("a",)), ("a",))[0].span == (0.5, 1.0)


def test_a_spreadsheet_is_named(tmp_path):
    (tmp_path / "captions.xlsx").write_bytes(b"PK\3\4")
    with pytest.raises(UserError, match="is a file of a spreadsheet program; save it as CSV"):
        load_caption_table(tmp_path / "captions.xlsx")


def test_accents_may_be_written_in_two_ways(tmp_path):
    """On a Mac, names of files have accents apart from their letters."""
    source = write_clips(tmp_path / "source", ["Jo\u0308rg", "._a"])
    (source / "captions.csv").write_text(f"file,caption\nJ\u00f6rg,{WALK}\n")
    report = import_bvh_folder(source, tmp_path / "data")
    assert report.left_out == {} and set(all_captions(tmp_path / "data")) == {"J\u00f6rg", "MJ\u00f6rg"}


def test_columns_that_are_not_read_are_named(tmp_path):
    source = write_clips(tmp_path / "source", ["a", "b"])
    (source / "captions.csv").write_text(f"file,caption,in,out,person\na,{WALK},0,1,ann\nb,{TURN},1,2,bob\n")
    report = import_bvh_folder(source, tmp_path / "data")
    assert "columns that are not read: 'in', 'out', 'person'" in report.notes
    report = import_bvh_folder(source, tmp_path / "other", split_by="person", split="50/0/50")
    assert "columns that are not read: 'in', 'out'" in report.notes


def test_columns_that_are_read_may_have_capitals(tmp_path):
    path = tmp_path / "captions.csv"
    path.write_text(f"File,Caption,Split,ACTION,Person,SHA256,Scene\na,{WALK},test,walk,ann,0123,hall\n")
    table = load_caption_table(path, keys=("a",))
    assert table.columns == ("split", "action", "person", "sha256", "Scene")
    assert find_entries(table, ("a",))[0].cells["split"] == "test"


def test_columns_of_one_name_are_all_read(tmp_path):
    said, problems, _ = read(tmp_path, f"file,caption,caption\na,{WALK},a second one\n")
    assert said["a"] == [WALK, "a second one"] and not problems
    said, problems, _ = read(tmp_path, f"file,caption,label,label\na,{WALK},walk,fast\n")
    assert said["a"] == [WALK] and not problems


def test_times_may_end_with_finish_but_not_with_a_duration(tmp_path):
    path = tmp_path / "captions.csv"
    path.write_text(f"file,caption,begin,finish\na,{WALK},1,2.5\n")
    assert find_entries(load_caption_table(path, keys=("a",)), ("a",))[0].span == (1.0, 2.5)
    for name in ("duration", "length_s"):
        path.write_text(f"file,caption,start,{name}\na,{WALK},1,2.5\n")
        with pytest.raises(UserError, match=f":1: '{name}' is not read; write when a caption ends"):
            load_caption_table(path, keys=("a",))
    # How long a motion is does not matter.
    path.write_text(f"file,caption,duration\na,{WALK},2.5\n")
    assert find_entries(load_caption_table(path, keys=("a",)), ("a",))[0].span == (0.0, 0.0)


def test_a_quote_that_goes_on_in_the_next_line_is_a_problem(tmp_path):
    said, problems, _ = read(tmp_path, f'file,caption\na,"a man\nwalks"\nb,"{TURN}"\n')
    assert said == {"a": [], "b": [TURN]}
    assert any(":2: a quote is not closed" in problem for problem in problems)


@pytest.mark.parametrize("column", ["height from floor", "distance to goal", "angle at start", "stop word"])
def test_a_column_about_something_else_is_no_time(tmp_path, column):
    path = tmp_path / "captions.csv"
    path.write_text(f"file,caption,{column}\na,{WALK},1.5\n")
    table = load_caption_table(path)
    assert table.columns == (column,) and not table.notes
    assert table.entries["a"][0].span == (0, 0)


@pytest.mark.parametrize(
    ("start", "end"),
    [("Start (s)", "End (s)"), ("from", "to"), ("clip_begin", "clip_end"), ("start time", "stop time")],
)
def test_names_of_times_are_noted(tmp_path, start, end):
    path = tmp_path / "captions.csv"
    path.write_text(f"file,caption,{start},{end}\na,{WALK},0.5,1.5\n")
    table = load_caption_table(path)
    assert table.entries["a"][0].span == (0.5, 1.5)
    assert any(note.endswith(f"times from {start!r}, {end!r}") for note in table.notes)


def test_what_was_guessed_is_noted(tmp_path):
    _, _, notes = read(tmp_path, f"clip,text\na,{WALK}\nb,{TURN}\n")
    assert any("read from 'text'" in note for note in notes)
    assert any("1 lines (3) have commas without quotes" in note for note in notes)
    _, _, notes = read(tmp_path, f"a,{WALK}\n")
    assert any("has no header" in note for note in notes)
    _, _, notes = read(tmp_path, f'file,caption\na,"{TURN}"\n')
    assert not notes


@pytest.mark.parametrize(
    ("row", "times"),
    [("a,he walks, and turns,0.5,2", (0.5, 2.0)), ('a,"he walks, and turns",0.5,2', (0.5, 2.0))],
)
def test_times_after_a_caption_with_commas(tmp_path, row, times):
    (tmp_path / "captions.csv").write_text(f"file,caption,start,end\n{row}\n")
    (found,) = find_entries(load_caption_table(tmp_path / "captions.csv"), ("a",))
    assert found.captions[0].text == "he walks, and turns"
    assert (found.captions[0].start, found.captions[0].end) == times


def test_decimal_commas_of_spreadsheets(tmp_path):
    (tmp_path / "captions.csv").write_text("file;caption;from (s);to (s)\na;he walks;0,5;2,25\n")
    (found,) = find_entries(load_caption_table(tmp_path / "captions.csv"), ("a",))
    assert (found.captions[0].start, found.captions[0].end) == (0.5, 2.25)


def test_several_captions_in_a_row(tmp_path):
    said, _, _ = read(tmp_path, "file,caption_1,caption_2\na,he walks,a man walks\nb,she waves,\n")
    assert said == {"a": ["he walks", "a man walks"], "b": ["she waves"]}
    _, problems, _ = read(tmp_path, "file,caption_1,caption_2\na,he walks, and turns,a man walks\n")
    assert len(problems) == 1 and "captions.csv:2: has 4 cells, the header 3" in problems[0]


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("b,", "captions.csv:3: file or caption is empty"),
        (",he walks", "captions.csv:3: file or caption is empty"),
        ("b", "captions.csv:3: file or caption is empty"),
        (",,", "captions.csv:3: file or caption is empty"),
        ("b,he # walks", "captions.csv:3: the caption has a '#'"),
        ("b,?!", "captions.csv:3: the caption '?!' has no words"),
        ("b,he waves,one,2", "captions.csv:3: start 'one' is not a number of seconds"),
        ("b,he waves,1e999,2", "captions.csv:3: start '1e999' is not a number of seconds"),
        ("b,he waves,3,1", "captions.csv:3: 3 to 1 s: the start must be 0 or more, and the end after it"),
        ("b,he waves,2,2", "captions.csv:3: 2 to 2 s: the start must be 0 or more, and the end after it"),
        ("b,he waves,-1,2", "captions.csv:3: -1 to 2 s: the start must be 0 or more, and the end after it"),
    ],
)
def test_a_broken_row_costs_no_other_row(tmp_path, row, says):
    said, problems, _ = read(tmp_path, f"file,caption,start,end\na,{WALK},,\n{row}\n")
    assert said["a"] == [WALK] and len(problems) == 1 and says in problems[0]


def test_short_rows_of_a_table_whose_files_come_last(tmp_path):
    said, problems, _ = read(tmp_path, f"actor,caption,file\nx,{WALK},a\ny\n")
    assert said["a"] == [WALK] and "captions.csv:3: file or caption is empty" in problems[0]


def test_an_open_quote_does_not_swallow_the_next_rows(tmp_path):
    said, problems, _ = read(tmp_path, f'file,caption\na,"{WALK}\nb,{TURN}\n')
    assert said == {"a": [WALK], "b": [TURN]} and not problems


def test_short_names_of_several_files_are_refused(tmp_path):
    path = tmp_path / "captions.csv"
    path.write_text("file,caption\nwalk,he walks\nx/walk,she walks\n")
    table = load_caption_table(path, keys=("x/walk", "y/walk"))
    assert [c.text for row in find_entries(table, ("x/walk", "walk")) for c in row.captions] == ["she walks"]
    assert "captions.csv:2: 2 files are called walk; write the folder" in table.entries["walk"][0].problem


def test_the_short_name_of_one_file_is_its_path_if_it_has_no_folder(tmp_path):
    path = tmp_path / "captions.csv"
    path.write_text("file,caption\nwalk.bvh,he walks\n")
    table = load_caption_table(path, keys=("walk", "sub/walk"))
    assert [c.text for row in find_entries(table, ("walk",)) for c in row.captions] == ["he walks"]
    assert not find_entries(table, ("sub/walk", "walk"))


@pytest.mark.parametrize("column", ["start_frame", "Start (frames)", "from [ms]", "StartFrame"])
def test_times_that_are_not_seconds_are_refused(tmp_path, column):
    with pytest.raises(UserError, match=r"captions\.csv:1: times are seconds, but the column '.*' has others"):
        read(tmp_path, f"file,caption,{column},end\na,{WALK},30,90\n")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('a,"a person waves",0:00,0:02', "start '0:00' is not a number of seconds"),
        ("a,a person waves,1s,2s", "start '1s' is not a number of seconds"),
        ("a,a person waves,0,abc", "end 'abc' is not a number of seconds"),
        ("a,a person waves,0,3,hello", "has 5 cells, the header 4; quote commas"),
        ("a,a person waves,-1,2", "-1 to 2 s: the start must be 0 or more"),
    ],
)
def test_what_cannot_be_a_time_is_no_part_of_the_caption(tmp_path, line, said):
    found, (problem,), _ = read(tmp_path, f"file,caption,start,end\n{line}\n")
    assert said in problem and found["a"] == []


@pytest.mark.parametrize(
    ("line", "caption"),
    [
        ("a,he walks 3 steps, 2 steps back", "he walks 3 steps, 2 steps back"),
        ('a,"a person waves",,,', "a person waves"),
        ('a,he says "hi", then waves', 'he says "hi", then waves'),
    ],
)
def test_commas_of_a_table_without_times_belong_to_the_caption(tmp_path, line, caption):
    found, problems, _ = read(tmp_path, f"file,caption\n{line}\n")
    assert found["a"] == [caption] and not problems


@pytest.mark.parametrize("header", ["caption,caption_2", "Caption,caption 2", "description,Description2"])
def test_a_first_caption_without_a_number_is_read_too(tmp_path, header):
    found, problems, _ = read(tmp_path, f"file,{header}\na,{WALK},he goes\nb,{WALK},\n")
    assert found == {"a": [WALK, "he goes"], "b": [WALK]} and not problems


def test_of_times_in_seconds_and_in_frames_those_in_seconds_are_read(tmp_path):
    header = "file,caption,start_frame,end_frame,start_sec,end_sec"
    (tmp_path / "captions.csv").write_text(f"{header}\na,{WALK},30,90,1.5,4.5\n")
    (row,) = find_entries(load_caption_table(tmp_path / "captions.csv", keys=("a",)), ("a",))
    assert row.span == (1.5, 4.5)


def test_a_row_of_one_file_is_not_taken_for_another(tmp_path):
    path = tmp_path / "captions.csv"
    path.write_text("file,caption\nwalk,he walks\n")
    table = load_caption_table(path, keys=("walk", "old/run"))
    assert find_entries(table, ("walk",)) and not find_entries(table, ("old/walk", "walk"))


@pytest.mark.parametrize("text", ["", "\n", "actor,take\nx,y\n", "one column\na\n", "x,y\n1,2\n"])
def test_no_table_at_all(tmp_path, text):
    with pytest.raises(UserError, match=r"captions\.csv:1: expected the columns file,caption"):
        read(tmp_path, text)


def test_headers_that_would_take_long_are_refused_at_once(tmp_path):
    with pytest.raises(UserError, match="expected the columns"):
        read(tmp_path, f"file,captionn{'9' * 100_000}\n")
    with pytest.raises(UserError, match=r"captions\.csv:1: has more than 1000 columns"):
        read(tmp_path, f"file,caption{',' * 2000}\n")


def test_an_import_loses_nothing_silently(tmp_path):
    source = write_clips(tmp_path / "source", ["a", "b", "c", "d"])
    (source / "captions.csv").write_text(
        "clip;text\na;he walks, slowly\nb;\nc;she waves\nghost;nobody\nc;it # is\n", encoding="utf-8"
    )
    report = import_bvh_folder(source, tmp_path / "data")
    assert all_captions(tmp_path / "data")["a"] == ["he walks, slowly"]
    assert set(report.left_out) == {"b", "d"} and "captions.csv:3: file or caption is empty" in report.left_out["b"]
    notes = "\n".join(report.notes)
    assert "captions.csv:5: there is no motion ghost" in notes and "captions.csv:6: the caption has a '#'" in notes
    assert "captions.csv:3" not in notes  # said with the clip


@pytest.mark.slow
def test_groups_stay_in_one_split(tmp_path):
    actors = {f"{actor}{take}": actor for actor in ("ann", "bob", "cy", "di") for take in range(3)}
    source = write_clips(tmp_path / "source", list(actors))
    rows = "".join(f"{name},he moves,{actor}\n" for name, actor in actors.items())
    (source / "captions.csv").write_text("file,caption,actor\n" + rows)
    report = import_bvh_folder(source, tmp_path / "data", split_by="actor", split="50/25/25")
    assert report.split_sizes == {"train": 12, "val": 6, "test": 6}
    for split in ("train", "val", "test"):
        names = (tmp_path / "data" / f"{split}.txt").read_text().split()
        assert len({actors[name.removeprefix("M")] for name in names}) == (2 if split == "train" else 1)


def test_groups_may_be_folders(tmp_path):
    source = tmp_path / "source"
    for folder in "xyz":
        for take in range(2):
            write_bvh(source / folder / f"{take}.bvh", seed=take)
    (source / "x" / "captions.csv").write_text("")  # only the one of the whole folder is read
    names = "".join(f"{folder}/{take},he moves\n" for folder in "xyz" for take in range(2))
    (source / "captions.csv").write_text("file,caption\n" + names)
    report = import_bvh_folder(source, tmp_path / "data", split_by="folder")
    assert report.split_sizes == {"train": 4, "val": 4, "test": 4}


def test_splits_may_be_given(tmp_path):
    source, lists = write_clips(tmp_path / "source", ["a", "b", "c"]), tmp_path / "lists"
    lists.mkdir()
    for split, names in (("train", "a\n"), ("val", "b\n"), ("test", "ghost\n")):
        (lists / f"{split}.txt").write_text(names)
    report = import_bvh_folder(source, tmp_path / "data", caption_from_name=True, split=lists)
    assert report.split_sizes == {"train": 2, "val": 2, "test": 0}
    assert "c is in no list" in report.left_out["c"]
    assert report.notes == (f"{lists}: 1 listed clips are no motion: ghost",)
    (lists / "test.txt").write_text("a\n")
    with pytest.raises(UserError, match="a is in two lists"):
        import_bvh_folder(source, tmp_path / "again", caption_from_name=True, split=lists)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"split": "80/20"}, "split '80/20': give the shares"),
        ({"split": "0/50/50"}, "split '0/50/50'"),
        ({"split": "a/b/c"}, "split 'a/b/c'"),
        ({"split": "nan/1/1"}, "split 'nan/1/1'"),
        ({"split": "-1/1/1"}, "split '-1/1/1'"),
        ({"split_by": "actor"}, "split_by 'actor': the table of captions has no such column; known: folder"),
        ({"split_by": "folder"}, "there are 1 groups"),
    ],
)
def test_divisions_that_cannot_be(tmp_path, options, says):
    source = write_clips(tmp_path / "source", ["a"])
    with pytest.raises(UserError, match=says):
        import_bvh_folder(source, tmp_path / "data", caption_from_name=True, **options)
    assert not (tmp_path / "data").exists()


def test_a_table_may_give_only_captions_and_splits(tmp_path):
    source = write_clips(tmp_path / "source", ["a", "b", "c"])
    (source / "captions.csv").write_text("file,caption,split\na,he walks,train\nb,she runs,test\nc,he waves,dev\n")
    report = import_bvh_folder(source, tmp_path / "data")
    assert report.split_sizes == {"train": 2, "val": 0, "test": 2}
    assert "split 'dev' is not train, val, test" in report.left_out["c"]


def test_all_of_a_split_may_go_to_training(tmp_path):
    source = write_clips(tmp_path / "source", ["a", "b", "c"])
    report = import_bvh_folder(source, tmp_path / "data", caption_from_name=True, split="1/0/0")
    assert report.split_sizes == {"train": 6, "val": 0, "test": 0}
    assert np.isfinite(np.load(tmp_path / "data" / "Mean.npy")).all()
