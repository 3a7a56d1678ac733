import dataclasses
import typing
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from t2m_jax.config import (
    Tagged,
    config_from_dict,
    config_to_dict,
    flat_fields,
    load_config,
    override_config,
    save_config,
    tag_of,
)
from t2m_jax.errors import UserError
from t2m_jax.yaml_file import MAX_DEPTH, MAX_FILE_BYTES


@dataclasses.dataclass(frozen=True, kw_only=True)
class Schedule:
    """Learning rate over the steps."""

    peak: float = 1e-3
    """Highest learning rate."""
    milestones: tuple[int, ...] = (10, 20)
    """Steps at which the rate drops."""
    nesterov: bool = False
    """Whether to look ahead."""

    def __post_init__(self):
        if self.peak < 0:
            raise ValueError(f"peak must not be negative, got {self.peak}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """One run."""

    steps: int
    """How many steps to take."""
    name: str = "run"
    """What the run is called."""
    kind: Literal["relu", "gelu", 3] = "relu"
    """Which nonlinearity."""
    folder: Path | None = None
    """Where it writes."""
    window: tuple[int, float] = (64, 0.5)
    """Frames, overlap."""
    limit: int | str = "none"
    """A count, or a word."""
    schedule: Schedule = Schedule()
    """Learning rate."""
    second: Schedule | None = None
    """Another one, for the second half."""


def load(tmp_path: Path, text: str, schema: type = Run):
    path = tmp_path / "run.yaml"
    path.write_text(text, encoding="utf-8")
    return load_config(path, schema)


def refusal(tmp_path: Path, text: str) -> str:
    """Returns the one line a broken file gets, without the folder."""
    with pytest.raises(UserError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{tmp_path}/", "")


def test_a_file_changes_what_it_names_and_leaves_the_rest(tmp_path):
    config = load(
        tmp_path,
        """
        # comments are fine
        steps: 5
        kind: gelu
        folder: runs/one
        window: [32, 1]
        limit: 7
        schedule:
          peak: 1e-4
          milestones: []
        second: {nesterov: true}
        """,
    )
    assert config == Run(
        steps=5,
        kind="gelu",
        folder=Path("runs/one"),
        window=(32, 1.0),
        limit=7,
        schedule=Schedule(peak=1e-4, milestones=()),
        second=Schedule(nesterov=True),
    )
    assert isinstance(config.window[1], float)


def test_an_empty_file_is_all_defaults(tmp_path):
    assert load(tmp_path, "# nothing here\n", Schedule) == Schedule()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("steps: 1\nstep: 2", "run.yaml:2: unknown key 'step'; did you mean 'steps'?"),
        ("steps: 1\npeak: 2", "run.yaml:2: unknown key 'peak'; did you mean 'schedule.peak'?"),
        ("steps: 1\nschedule:\n  peek: 2", "run.yaml:3: unknown key 'schedule.peek'; did you mean 'schedule.peak'?"),
        ("schedule:\n  zzz: 2", "unknown key 'schedule.zzz'; known: schedule.peak, schedule.milestones"),
        ("7: 2", "run.yaml:1: unknown key '7'"),
        ("name: a", "run.yaml: missing field 'steps'; it has no default"),
        ("steps: 1.0", "run.yaml:1: steps: expected a whole number, got 1.0"),
        ("steps: true", "run.yaml:1: steps: expected a whole number, got True"),
        ("steps: 1\nname: 12", "run.yaml:2: name: expected text (in quotes if need be), got 12"),
        ("steps: 1\nkind: tanh", "run.yaml:2: kind: expected one of 'relu', 'gelu', 3, got 'tanh'"),
        ("steps: 1\nfolder: 3", "run.yaml:2: folder: expected a path, got 3"),
        ("steps: 1\nwindow: [1]", "run.yaml:2: window: expected a list [a whole number, a number], got [1]"),
        ("steps: 1\nlimit: 1.5", "run.yaml:2: limit: expected a whole number or text (in quotes if need be), got 1.5"),
        ("steps: 1\nschedule: 3", "run.yaml:2: schedule: expected a section of fields, got 3"),
        ("steps: 1\nschedule:", "run.yaml:2: schedule: expected a section of fields, got None"),
        ("steps: 1\nschedule:\n  peak: fast", "run.yaml:3: schedule.peak: expected a number, got 'fast'"),
        ("steps: 1\nschedule:\n  peak: .nan", "run.yaml:3: schedule.peak: expected a number, got nan"),
        ("steps: 1\nschedule:\n  nesterov: 1", "run.yaml:3: schedule.nesterov: expected true or false, got 1"),
        (
            "steps: 1\nschedule:\n  milestones: [1, a]",
            "schedule.milestones: expected a whole number, got 'a'",
        ),
        ("steps: 1\nschedule:\n  peak: -1", "run.yaml:2: schedule: peak must not be negative, got -1"),
        ("steps: 1\nsteps: 2", "run.yaml:2: cannot read this YAML: found duplicate key 'steps'"),
        ("steps: [1, 2", "run.yaml:1: cannot read this YAML"),
        ("steps: 1\n\tname: a", "run.yaml:2: cannot read this YAML"),
        ("- 1", "run.yaml:1: cannot read this YAML: expected 'field: value' lines"),
        ("just words", "run.yaml:1: cannot read this YAML: expected 'field: value' lines"),
        ("steps: 1\nname: \x07", "run.yaml: cannot read this YAML: unacceptable character"),
        ("steps: 1\nname: ${oc.env:HOME}", "run.yaml:2: cannot read this YAML: interpolation"),
        ("steps: 1\nname: ${", "run.yaml:2: cannot read this YAML: interpolation"),
        ("steps: !!python/object/apply:os.getcwd []", "run.yaml:1: cannot read this YAML: tags"),
        ("schedule: &a {peak: 1}\nsecond: *a", "run.yaml:1: cannot read this YAML: anchors"),
        ("steps: 1\n---\nsteps: 2", "cannot read this YAML"),
        ("steps: 0b_", "run.yaml: cannot read this YAML"),
        (f"steps: 0x{'f' * 6000}", "run.yaml:1: cannot read this YAML: whole number of too many digits"),
        ("steps: " + "9" * 5000, "run.yaml: cannot read this YAML"),
        ("steps: 1\nschedule:\n  peak: " + "9" * 400, "run.yaml:3: schedule.peak: expected a number, got 9999"),
        ("null: 1", "run.yaml: unknown key 'None'"),
        ("<<: {steps: 1}", "run.yaml:1: unknown key '<<'"),
        ("? [1]\n: 1", "run.yaml:1: cannot read this YAML"),
        ('"a\\nb": 1', "run.yaml:1: unknown key 'a b'"),
        ("steps: " + "[" * 5000, f"run.yaml:1: cannot read this YAML: nested deeper than {MAX_DEPTH}"),
    ],
)
def test_refusals_are_one_line_with_file_line_and_field(tmp_path, text, message):
    assert message in refusal(tmp_path, text)


def test_an_alias_bomb_is_refused_before_it_grows(tmp_path):
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30)]
    assert "anchors and aliases" in refusal(tmp_path, "\n".join(rows))


@pytest.mark.parametrize("text", ["2020-01-01", "2020-99-99", "1e", "<<", "=", "'12'", "a b  # comment"])
def test_text_needs_quotes_only_if_it_looks_like_another_type(tmp_path, text):
    assert load(tmp_path, f"steps: 1\nname: {text}").name == text.strip("'").partition("  #")[0]


def test_a_file_of_the_previous_writer_is_read(tmp_path):
    """OmegaConf wrote the config files of older runs and bundles."""
    text = "steps: 3\nname: '1e-4'\nkind: 3\nfolder: a/b\nwindow:\n- 1\n- 5.0e-05\nlimit: 'on'\n"
    text += "schedule:\n  peak: .inf\n  milestones: []\n  nesterov: false\nsecond: null\n"
    config = load(tmp_path, text)
    schedule = Schedule(peak=float("inf"), milestones=())
    assert config == Run(
        steps=3, name="1e-4", kind=3, folder=Path("a/b"), window=(1, 5e-5), limit="on", schedule=schedule
    )
    save_config(tmp_path / "again.yaml", config)
    assert (tmp_path / "again.yaml").read_text() == text


def test_files_that_are_none(tmp_path):
    with pytest.raises(UserError, match=r"missing\.yaml: no such config file"):
        load_config(tmp_path / "missing.yaml", Run)
    with pytest.raises(UserError, match="a folder"):
        load_config(tmp_path, Run)
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match=r"binary\.yaml: not a text file"):
        load_config(path, Run)
    path.write_bytes(b"#" * (MAX_FILE_BYTES + 1))
    with pytest.raises(UserError, match="larger than"):
        load_config(path, Run)


schedules = st.builds(
    Schedule,
    peak=st.floats(min_value=0, allow_nan=False),
    milestones=st.lists(st.integers(), max_size=4).map(tuple),
    nesterov=st.booleans(),
)
words = st.text().filter(lambda text: "${" not in text) | st.sampled_from(
    [
        "1e-4",
        "1e5",
        "1_0.e3",
        ".5",
        "on",
        "null",
        "~",
        "???",
        "12",
        "",
        "2020-01-01",
        "2020-99-99",
        "<<",
        "=",
        "0x1",
        "1:30",
    ]
)
runs = st.builds(
    Run,
    steps=st.integers(),
    name=words,
    kind=st.sampled_from(["relu", "gelu", 3]),
    folder=st.none() | st.sampled_from([Path("a b/c"), Path("/"), Path("."), Path("12")]),
    window=st.tuples(st.integers(), st.floats(allow_nan=False)),
    limit=st.integers() | words,
    schedule=schedules,
    second=st.none() | schedules,
)


@given(config=runs)
def test_saving_and_loading_is_the_identity(config, tmp_path_factory):
    path = tmp_path_factory.mktemp("configs") / "run.yaml"
    save_config(path, config)
    assert load_config(path, Run) == config
    assert [file.name for file in path.parent.iterdir()] == ["run.yaml"]


@given(config=runs)
def test_dictionaries_there_and_back_is_the_identity(config):
    assert config_from_dict(Run, config_to_dict(config)) == config


def test_what_could_not_be_read_back_is_not_written(tmp_path):
    path = tmp_path / "run.yaml"
    with pytest.raises(UserError, match="window: expected a list"):
        save_config(path, Run(steps=1, window=(1, 2, 3)))  # type: ignore[arg-type]
    assert not path.exists()


def test_dictionary_errors_name_their_source():
    with pytest.raises(UserError, match=r"^bundle\.json: unknown key 'stepps'; did you mean 'steps'\?$"):
        config_from_dict(Run, {"stepps": 1}, source="bundle.json")


def test_options_change_fields():
    args = ["--steps", "9", "--schedule.peak", "1e-4", "--schedule.milestones", "1", "2", "--schedule.nesterov"]
    config = override_config(Run(steps=1, name="kept"), [*args, "--folder=out"], prog="t2m train")
    schedule = Schedule(peak=1e-4, milestones=(1, 2), nesterov=True)
    assert config == Run(steps=9, name="kept", folder=Path("out"), schedule=schedule)


def test_no_options_change_nothing():
    assert override_config(Run(steps=3), [], prog="t2m train") == Run(steps=3)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--stepps", "3"], "t2m train: unknown option '--stepps'; did you mean '--steps'?"),
        (["--schedule.peek=3"], "t2m train: unknown option '--schedule.peek=3'; did you mean '--schedule.peak'?"),
        (["--milestonse", "3"], "t2m train: unknown option '--milestonse'; did you mean '--second.milestones'?"),
        (["stray"], "t2m train: unknown option 'stray'"),
        (["--steps", "many"], "--steps: "),
        (["--steps"], "--steps"),
        (["--kind", "tanh"], "'tanh'"),
        (["--schedule.peak", "-1"], "peak must not be negative"),
        (["--schedule.peak", "nan"], "schedule.peak: expected a number, got nan"),
        (["--name", "${x}"], "name: expected text"),
    ],
)
def test_wrong_options_get_one_line(args, message):
    with pytest.raises(UserError) as caught:
        override_config(Run(steps=3), args, prog="t2m train")
    assert message in str(caught.value)
    assert str(caught.value).startswith("t2m train: ")
    assert len(str(caught.value).splitlines()) == 1
    assert not set(str(caught.value)) & set("│╭╰─")


def test_help_lists_every_field_with_its_docstring(capsys):
    with pytest.raises(SystemExit) as caught:
        override_config(Run(steps=3), ["--help"], prog="t2m train")
    assert caught.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name in [field for field in typing.get_type_hints(Run) if field not in ("schedule", "second")]:
        assert f"--{name}" in shown
    for text in ("How many steps to take.", "--schedule.peak", "Highest learning rate.", "(default: 3)"):
        assert text in shown


@dataclasses.dataclass(frozen=True, kw_only=True)
class Circle:
    """A section whose class its kind names."""

    kind: ClassVar[str] = "circle"
    radius: float = 1.0
    """Meters."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Square:
    """Another one."""

    kind: ClassVar[str] = "square"
    side: int
    """Meters."""


def find_shape(kind: str) -> type:
    """Returns the class of a kind."""
    for shape in (Circle, Square):
        if shape.kind == kind:
            return shape
    raise UserError(f"unknown kind {kind!r}; known: circle, square")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drawing:
    """A config with a field of any shape and one of a fixed shape."""

    shape: Annotated[Any, Tagged(find_shape)]
    """Any shape."""
    hole: Circle = Circle()
    """Always a circle."""
    second: Circle | None = None
    """A circle or nothing."""


DRAWING = Drawing(shape=Square(side=2), hole=Circle(radius=0.5))


def test_a_section_of_several_kinds_is_written_with_its_kind_and_read_back(tmp_path):
    save_config(tmp_path / "drawing.yaml", DRAWING)
    text = (tmp_path / "drawing.yaml").read_text()
    assert text == "shape:\n  kind: square\n  side: 2\nhole:\n  kind: circle\n  radius: 0.5\nsecond: null\n"
    assert load_config(tmp_path / "drawing.yaml", Drawing) == DRAWING
    assert config_from_dict(Drawing, config_to_dict(DRAWING)) == DRAWING
    assert flat_fields(DRAWING) == {"shape.side": 2, "hole.radius": 0.5, "second": None}


def test_kind_is_optional_if_the_class_is_fixed():
    assert config_from_dict(Circle, {}) == config_from_dict(Circle, {"kind": "circle"}) == Circle()
    data = {"shape": {"kind": "circle"}, "hole": {"radius": 2}, "second": {"kind": "circle"}}
    expected = Drawing(shape=Circle(), hole=Circle(radius=2.0), second=Circle())
    assert config_from_dict(Drawing, data) == expected
    assert (tag_of(Circle), tag_of(Schedule), tag_of(Run)) == ("circle", None, None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hole: {}", "drawing.yaml: missing field 'shape'; it has no default"),
        ("shape: 3", "drawing.yaml:1: shape: expected a section of fields, got 3"),
        (
            "shape:\n  side: 2",
            "drawing.yaml:1: shape.kind: expected text that names the kind of this section, got None",
        ),
        (
            "shape:\n  kind: [1]",
            "drawing.yaml:2: shape.kind: expected text that names the kind of this section, got [1]",
        ),
        ("shape:\n  kind: star", "drawing.yaml:2: shape.kind: unknown kind 'star'; known: circle, square"),
        ("shape:\n  kind: circle\n  side: 2", "drawing.yaml:3: unknown key 'shape.side'; known: shape.radius"),
        ("shape:\n  kind: square\n  sides: 2", "drawing.yaml:3: unknown key 'shape.sides'; did you mean 'shape.side'?"),
        ("shape:\n  kind: square", "drawing.yaml:1: missing field 'shape.side'; it has no default"),
        ("shape: {kind: circle}\nhole:\n  kind: square", "drawing.yaml:3: hole.kind: expected 'circle', the kind of"),
    ],
)
def test_a_wrong_kind_gets_one_line_with_file_line_and_field(tmp_path, text, message):
    path = tmp_path / "drawing.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError) as caught:
        load_config(path, Drawing)
    assert str(caught.value).replace(f"{tmp_path}/", "").startswith(message)
