"""Tables of captions as people write them: with commas, semicolons or tabs, other names of columns, or no header.

Each line of a file is one row. A row that cannot be used costs no other row: it keeps its problem, for the report.
"""

import csv
import re
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from t2m_jax.data.folder import first_names
from t2m_jax.data.importers.plain_captions import tagged_caption
from t2m_jax.data.texts import Caption
from t2m_jax.errors import UserError
from t2m_jax.files.reading import load_text
from t2m_jax.text.verbs import word_set

MAX_COLUMNS = 1000
"""Most columns of a table; a spreadsheet of captions has some tens."""
SPREADSHEETS = (".xlsx", ".xls", ".ods", ".numbers")
TABLES = (".csv", ".tsv")
DELIMITERS = (",", ";", "\t", "|")
NAMES = {
    "caption": ("caption", "captions", "text", "description", "sentence", "annotation", "prompt", "label"),
    "start": ("start", "from", "begin"),
    "end": ("end", "to", "stop", "finish", "until"),
    "file": ("file", "filename", "path", "filepath", "bvh", "clip", "motion", "take", "name", "id"),
}
"""Names of columns by what is in them, the best ones first. One word of several is enough: `Clip name`."""
ACTION = "action"
PERSON = "person"
SPLIT = "split"
"""Columns of tables whose rows are clips (see `table_parts`)."""
DIGEST = "sha256"
"""Column with the first digits of the SHA-256 of each motion file."""
OWN_COLUMNS = (ACTION, PERSON, SPLIT, DIGEST)
"""Columns that are read beside files, captions and times; users may divide by the others."""
LENGTHS = frozenset({"duration", "length", "dur", "len"})
"""Words in the name of a column that says how long a caption holds."""
NOT_SECONDS = frozenset({"frame", "frames", "ms", "msec", "milliseconds"})
"""Words in the name of a column of times that are not seconds."""
_ABOUT_TIMES = NOT_SECONDS | word_set("at clip caption in motion part s sec seconds second segment t text time times")
"""Other words in the name of a column of times: `Start (s)`, `clip_end`, but not `height from floor`."""
_CAMEL_CASE = re.compile(r"(?<=[a-z])(?=[A-Z])")
MOTION_SUFFIXES = re.compile(r"\.(bvh|glb|amc|fbx|npy|npz|c3d)(?=$|/)", re.IGNORECASE)


class CaptionEntry(NamedTuple):
    """A row of a table."""

    place: str
    """`file:line`."""
    file: str
    """What it calls the motion, without a suffix and with forward slashes."""
    captions: tuple[Caption, ...]
    problem: str
    """Why the row cannot be used; empty if it can."""
    cells: Mapping[str, str]
    """The other cells by the names of their columns."""
    span: tuple[float, float] = (0.0, 0.0)
    """Seconds of the motion that it is about; zeros are the beginning and the end."""


class CaptionTable(NamedTuple):
    """The rows of a table by the last part of what they call their motion, in lower case."""

    entries: Mapping[str, Sequence[CaptionEntry]]
    columns: tuple[str, ...] = ()
    """Names of the columns that have neither a file, nor a caption, nor a time."""
    keys: frozenset[str] = frozenset()
    """What tables call the motion files of the folder: their paths below it."""
    notes: tuple[str, ...] = ()
    """What was guessed."""


def load_caption_table(path: Path, *, keys: Collection[str] = ()) -> CaptionTable:
    """Returns the rows of a table, or of lines `file: caption` (or with a tab in place of the colon).

    Args:
        path: A file in UTF-8; `.csv`, `.tsv`, and other files with a header or three columns between tabs are tables.
        keys: What tables call the motion files of the folder. A first row that begins with one of them is no header.

    Raises:
        UserError: The file is missing, is not UTF-8, or has no columns of files and captions.
    """
    if not path.is_file():
        raise UserError(f"{path}: no such file; give a .csv with file,caption or a .txt with 'file: caption' lines")
    if path.suffix.lower() in SPREADSHEETS:
        raise UserError(f"{path}: is a file of a spreadsheet program; save it as CSV in UTF-8")
    lines = load_text(path).split("\n")
    numbered = [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]
    columns: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    if path.suffix.lower() in TABLES or (numbered and _has_tabs(path, numbered[0][1])):
        layout = _find_layout(path, numbered[0][1] if numbered else "", keys)
        # A quote that a later line closes: a cell of two lines. Without such a line, it only looks like one.
        odd = [number for number, line in numbered if line.count('"') % 2]
        is_open = set(odd[:-1])
        rows = [
            _read_entry(f"{path}:{number}", line, layout, is_open=number in is_open)
            for number, line in numbered[layout.has_header :]
        ]
        columns = tuple(layout.others)
        notes = layout.notes
        joined = [row.place.rpartition(":")[2] for row, count in rows if count]
        if joined:
            lines_with = f"{len(joined)} lines ({first_names(joined)})"
            notes += (f"{path}: the captions of {lines_with} have commas without quotes; all was kept",)
        found = [row for row, _ in rows]
    else:
        found = [_read_pair(f"{path}:{number}", line) for number, line in numbered]
    by_name: dict[str, list[CaptionEntry]] = defaultdict(list)
    num_files = Counter(map(_last_part, keys))
    for row in found:
        name = _last_part(row.file)
        # A file of the folder itself has no other path than its name.
        by_name[name].append(row if row.file in keys else _refuse_if_ambiguous(row, num_files[name]))
    return CaptionTable(dict(by_name), columns, frozenset(keys), notes)


def find_entries(table: CaptionTable, candidates: Sequence[str]) -> list[CaptionEntry]:
    """Returns the rows of a motion.

    Args:
        table: The table.
        candidates: What it may call the motion. The first one is its path below the folder, which a longer path may
            end with, too.
    """
    near = [row for last in dict.fromkeys(map(_last_part, candidates)) for row in table.entries.get(last, ())]
    names = {candidate.casefold() for candidate in candidates}
    tail = f"/{candidates[0].casefold()}"
    return [
        row
        for row in near
        # A row with the exact path of one file must not count for another file of that name.
        if row.file == candidates[0]
        or (row.file not in table.keys and (row.file.casefold() in names or row.file.casefold().endswith(tail)))
    ]


def _refuse_if_ambiguous(row: CaptionEntry, num_files: int) -> CaptionEntry:
    """Returns the row, with a problem if it names only the last part of the paths of several files."""
    if num_files < 2 or "/" in row.file or row.problem:
        return row
    return row._replace(captions=(), problem=f"{row.place}: {num_files} files are called {row.file}; write the folder")


class _Layout(NamedTuple):
    """What is where in the rows of a table."""

    delimiter: str
    has_header: bool
    file: int
    captions: tuple[int, ...]
    times: Mapping[str, int]
    """Columns of `start` and `end`, as far as there are any."""
    others: Mapping[str, int]
    width: int
    notes: tuple[str, ...] = ()


def _last_part(key: str) -> str:
    return key.rpartition("/")[2].casefold()


def _motion_key(cell: str) -> str:
    """Returns what a cell calls a motion: without a suffix, quotes or `./`, with forward slashes."""
    path = unicodedata.normalize("NFC", cell.strip().strip("\"'"))  # macOS writes accents apart from their letters
    return MOTION_SUFFIXES.sub("", path.replace("\\", "/").removeprefix("./"))


def _split_line(line: str, delimiter: str) -> list[str]:
    # Each line alone, so that a quote that is never closed does not take the rest of the table.
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]


def _has_tabs(path: Path, line: str) -> bool:
    """Returns whether the first line of a text file is that of a table, as spreadsheets save it."""
    cells = line.split("\t")
    return len(cells) > 2 or _read_header(path, cells, "\t") is not None


def _find_layout(path: Path, header: str, keys: Collection[str]) -> _Layout:
    """Returns the layout that fits the first line of a table: its header, or the row of a motion that exists."""
    try:
        candidates = {delimiter: _split_line(header, delimiter) for delimiter in DELIMITERS}
    except csv.Error as error:
        raise UserError(f"{path}:1: is not a table ({error}); save it as CSV") from error
    if max(map(len, candidates.values())) > MAX_COLUMNS:
        raise UserError(f"{path}:1: has more than {MAX_COLUMNS} columns")
    for delimiter, cells in candidates.items():
        layout = _read_header(path, cells, delimiter)
        if layout:
            return layout
    known = {key.casefold() for key in keys} | {_last_part(key) for key in keys}
    for delimiter, cells in candidates.items():
        if len(cells) > 1 and {_motion_key(cells[0]).casefold(), _last_part(_motion_key(cells[0]))} & known:
            note = f"{path}: has no header; read as file, caption, start, end"
            return _Layout(delimiter, False, 0, (1,), {"start": 2, "end": 3}, {}, 4, (note,))
    raise UserError(f"{path}:1: expected the columns file,caption[,start,end]; the first line is {header[:60]!r}")


def _read_header(path: Path, cells: Sequence[str], delimiter: str) -> _Layout | None:
    """Returns the layout that a header describes, None if it does not name files and captions."""
    names = [re.sub(r"[\W_]+", "_", _CAMEL_CASE.sub("_", cell.strip()).lower()).strip("_") for cell in cells]
    found = _find_columns(names)
    # Several captions may be in several columns: caption_1, caption_2, or in two of the best name.
    stems = [name.rstrip("0123456789").rstrip("_") for name in names]
    counted = {stem for stem, name in zip(stems, names, strict=True) if stem in NAMES["caption"] and stem != name}
    best = None if found["caption"] is None else names[found["caption"]]
    first = tuple(place for place, name in enumerate(names) if name == best)
    captions = tuple(place for place, stem in enumerate(stems) if stem in counted) or first
    if found["file"] is None or not captions:
        return None
    times = {role: place for role in ("start", "end") if (place := found[role]) is not None}
    for place in times.values():
        if _is_not_seconds(names[place]):
            raise UserError(f"{path}:1: times are seconds, but the column {cells[place]!r} has others; convert it")
    used = (found["file"], *captions, *times.values())
    # Columns that are read have one name; users name the others as they are.
    others = {
        names[place] if names[place] in OWN_COLUMNS else cell: place
        for place, cell in enumerate(cells)
        if place not in used
    }
    lengths = [name for name in names if LENGTHS & {*name.split("_")}]
    if list(times) == ["start"] and lengths:
        raise UserError(f"{path}:1: {lengths[0]!r} is not read; write when a caption ends in a column `end`")
    said, told = (", ".join(repr(cells[place]) for place in places) for places in (captions, times.values()))
    notes = (f"{path}: captions are read from {said}" + (f", times from {told}" if times else ""),)
    is_plain = [names[place] for place in (found["file"], *captions, *times.values())] == ["file", "caption", *times]
    return _Layout(delimiter, True, found["file"], captions, times, others, len(cells), () if is_plain else notes)


def _find_columns(names: Sequence[str]) -> dict[str, int | None]:
    """Returns the column of each role: the one with the best name, or else with a word that is one."""
    found: dict[str, int | None] = {}
    for role, known in NAMES.items():
        # In the order of the roles: `Clip caption` is a caption, and only what is left can be a file.
        free = {place: name for place, name in enumerate(names) if place not in found.values()}
        exact = [place for name in known for place, own in free.items() if own == name]
        partly = [place for name in known for place, own in free.items() if name in own.split("_")]
        if role in ("start", "end"):
            partly = [place for place in partly if {*free[place].split("_")} <= {*known, *_ABOUT_TIMES}]
        # Of times in seconds and in frames, those in seconds.
        found[role] = next(iter(sorted([*exact, *partly], key=lambda place: _is_not_seconds(names[place]))), None)
    return found


def _is_not_seconds(name: str) -> bool:
    return not NOT_SECONDS.isdisjoint(name.split("_"))


def _looks_like_time(cell: str) -> bool:
    """Returns whether a cell is a time, perhaps one that cannot be read: 1s, 0:02."""
    return re.fullmatch(r"[+-]?[\d.,:]*\d[.,]?\s*[a-z]{0,12}", cell, re.IGNORECASE) is not None


def _is_time(cell: str) -> bool:
    # Spreadsheets of many countries write a comma in place of the point.
    return re.fullmatch(r"[+-]?\d+([.,]\d*)?|[+-]?[.,]\d+|nan|", cell, re.IGNORECASE) is not None


def _join_commas(cells: list[str], layout: _Layout) -> tuple[list[str], int]:
    """Returns the cells of a row in which commas of the caption that have no quotes are put back, and their number.

    The times must then be all there or all missing; otherwise the row may have a wrong time, and is left as it is.
    """
    caption = layout.captions[0]
    fewest = max(len(cells) - layout.width, 0)
    most = len(cells) - caption if layout.file < caption else fewest + 1
    for extra in range(fewest, most):
        end = caption + extra + 1
        joined = [*cells[:caption], f"{layout.delimiter} ".join(cells[caption:end]), *cells[end:]]
        joined += [""] * (layout.width - len(joined))
        times = [joined[place] for place in layout.times.values()]
        complete = sum(map(bool, times)) in (0, len(times))
        has_time = bool(times) and any(map(_looks_like_time, cells[caption + 1 : end]))
        if all(map(_is_time, times)) and (extra == 0 or (complete and not has_time)):
            return joined, extra
    return cells, 0


def _read_entry(place: str, line: str, layout: _Layout, *, is_open: bool) -> tuple[CaptionEntry, int]:
    """Returns a row and the number of commas without quotes in its caption."""
    try:
        cells = _split_line(line, layout.delimiter)
    except csv.Error as error:
        return CaptionEntry(place, "", (), f"{place}: is not a row of a table ({error})", {}), 0
    while len(cells) > layout.width and not cells[-1]:  # as spreadsheets write them
        cells.pop()
    cells += [""] * (layout.width - len(cells))
    joined = 0
    # Quotes say where a caption ends, and so do semicolons and tabs, which hardly any caption has.
    has_quotes = re.search(r'(?:^|,)\s*"', line) is not None
    if is_open:
        problem = f"{place}: a quote is not closed; write all of the row on one line"
        return CaptionEntry(place, _motion_key(cells[layout.file]), (), problem, {}), 0
    if len(layout.captions) == 1 and layout.delimiter == "," and not has_quotes:
        cells, joined = _join_commas(cells, layout)
    if len(cells) > layout.width:
        problem = f"{place}: has {len(cells)} cells, the header {layout.width}; quote commas"
        return CaptionEntry(place, "", (), problem, {}), 0
    times = {role: cells[column].replace(",", ".") for role, column in layout.times.items()}
    said = [cells[column] for column in layout.captions if cells[column]]
    others = {name: cells[column] for name, column in layout.others.items()}
    return _make_entry(place, cells[layout.file], said, times, others), joined


def _read_pair(place: str, line: str) -> CaptionEntry:
    """Returns the row of a line `file: caption`."""
    file, _, said = line.partition("\t" if "\t" in line else ":")
    return _make_entry(place, file, [said] * bool(said.strip()), {}, {})


def _make_entry(
    place: str, file: str, said: Sequence[str], times: Mapping[str, str], others: Mapping[str, str]
) -> CaptionEntry:
    """Returns a row with its captions, or with what is wrong with it."""
    key = _motion_key(file)
    # A row with an action needs no caption: the action is put into words.
    if not key or not (said or others.get(ACTION)):
        problem = f"{place}: file or caption is empty; fill in both or remove the line"
        return CaptionEntry(place, key, (), problem, others)
    for role, time in times.items():
        if not _is_time(time.strip()):
            return CaptionEntry(place, key, (), f"{place}: {role} {time!r} is not a number of seconds", others)
    try:
        # The times are read like those of a caption, also if there is none.
        spans = [tagged_caption(text, source=place, **times) for text in said or (others[ACTION],)]
        captions = tuple(spans) if said else ()
        return CaptionEntry(place, key, captions, "", others, (spans[0].start, spans[0].end))
    except UserError as error:
        return CaptionEntry(place, key, (), str(error), others)
