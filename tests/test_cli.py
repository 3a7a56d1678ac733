import argparse
import errno
import importlib
import importlib.metadata
import logging
import os
import signal
import subprocess
import sys
import time
import types

import jax
import numpy as np
import pytest

from t2m_jax.cli.main import COMMANDS, _PrintableFormatter, main
from t2m_jax.cli.options import show_next
from t2m_jax.errors import Interruption, UserError
from t2m_jax.evaluation.report.comparison import comparison_table
from t2m_jax.files.locks import lock
from t2m_jax.files.writing import atomic_file
from tests.export.test_html import Elements


@pytest.fixture
def command(monkeypatch):
    """Returns a function that adds the command `fake`, whose `run` is given."""

    def add(run=lambda args: None, **attributes):
        module = types.ModuleType("t2m_jax.cli.fake", "Does nothing.")

        def add_arguments(parser: argparse.ArgumentParser) -> None:
            parser.add_argument("text", nargs="*")
            parser.add_argument("--seed", type=int, default=0)

        module.__dict__.update(add_arguments=add_arguments, run=run, **attributes)
        monkeypatch.setitem(COMMANDS, "fake", "do nothing")
        monkeypatch.setitem(sys.modules, "t2m_jax.cli.fake", module)

    return add


def raising(error: BaseException):
    """Returns a `run` that ends in an error."""

    def run(args):
        raise error

    return run


def test_a_command_gets_its_arguments(command, capsys):
    seen = []
    command(seen.append)
    assert main(["fake", "a person waves", "--seed", "3"]) == 0
    assert (seen[0].text, seen[0].seed) == (["a person waves"], 3)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fakee"], "unknown command 'fakee'; did you mean 'fake'?"),
        (["zzzzzz"], "unknown command 'zzzzzz'; known: generate, "),
        (["--versionn"], "unrecognized arguments: --versionn"),
        (["fake", "--seed", "x"], "fake: argument --seed: invalid int value: 'x' (see `t2m fake --help`)"),
        (["fake", "--sed", "3"], "fake: unknown argument '--sed'; did you mean '--seed'?"),
        (["fake", "--see=3"], "fake: unknown argument '--see=3'; did you mean '--seed'?"),
    ],
)
def test_refusals_of_arguments_are_one_line(command, capsys, arguments, message):
    command()
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"t2m: error: {message}")
    assert printed.err.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (UserError("config.yaml:3: unknown key 'a'"), "config.yaml:3: unknown key 'a'"),
        (UserError("two\nlines \x1b[31mred\x07"), r"two lines \x1b[31mred\x07"),
        (UserError("wie schön 🙂"), "wie schön 🙂"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "a.npz"), "a.npz: No such file or directory"),
        (PermissionError(errno.EACCES, "Permission denied", "/root/x"), "/root/x: Permission denied"),
        (IsADirectoryError(errno.EISDIR, "Is a directory", "runs"), "runs: Is a directory"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (FileNotFoundError("no model in runs/a"), "no model in runs/a"),
    ],
)
def test_mistakes_of_the_user_end_in_one_line_and_code_2(command, capsys, error, line):
    command(raising(error))
    assert main(["fake"]) == 2
    assert capsys.readouterr().err == f"t2m: error: {line}\n"


@pytest.mark.parametrize(
    "arguments", [["--debug", "fake"], ["fake", "--debug"], ["fake", "x", "--debug", "--seed", "1"]]
)
def test_debug_shows_the_traceback_wherever_it_stands(command, capsys, arguments):
    command(raising(UserError("no such joint")))
    assert main(arguments) == 2
    printed = capsys.readouterr().err
    assert "Traceback" in printed
    assert printed.endswith("t2m: error: no such joint\n")


def test_text_after_a_double_dash_is_no_option(command):
    seen = []
    command(seen.append)
    assert main(["fake", "--", "--debug", "--seed"]) == 0
    assert seen[0].text == ["--debug", "--seed"]


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (KeyError("bug"), "KeyError in test_cli.py:"),
        (RecursionError("deep"), "RecursionError in test_cli.py:"),
        (ZeroDivisionError("\x1b[31m" + "x" * 10_000), r"ZeroDivisionError in test_cli.py:"),
    ],
)
def test_a_bug_is_one_line_that_says_where_it_happened(command, capsys, error, says):
    command(raising(error))
    assert main(["fake"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"t2m: error: {says}") and len(line) < 450
    assert line.endswith("(a bug of t2m_jax: run it again with --debug, and report what that prints)")
    assert main(["fake", "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_too_little_memory_is_no_bug(command, capsys):
    wrapped = RuntimeError("a motion was not made")
    wrapped.__cause__ = MemoryError()
    full = "RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."
    for error in (
        MemoryError(),
        wrapped,
        jax.errors.JaxRuntimeError(full),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
    ):
        command(raising(error))
        assert main(["fake"]) == 2
        assert capsys.readouterr().err == "t2m: error: out of memory; give fewer or smaller inputs at once\n"


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (Interruption(signal.SIGINT), 130, "interrupted by SIGINT"),
        (Interruption(signal.SIGTERM, "kept"), 143, "kept"),
    ],
)
def test_an_interrupt_is_no_traceback(command, capsys, error, code, line):
    command(raising(error))
    assert main(["fake"]) == code
    assert capsys.readouterr().err == f"t2m: error: {line}\n"


def test_an_interrupt_that_a_library_turns_into_an_error_is_one(command, capsys):
    def restore(args):
        try:
            try:
                raise Interruption(signal.SIGTERM)
            except BaseException as error:
                raise RuntimeError("cannot read index 0") from error
        except RuntimeError:
            raise UserError("the checkpoint is damaged")  # noqa: B904 - Python keeps what was handled

    command(restore)
    assert main(["fake"]) == 143
    assert capsys.readouterr().err == "t2m: error: interrupted by SIGTERM\n"


@pytest.mark.skipif(os.name != "posix", reason="Windows has other signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGUSR1"])
def test_signals_remove_what_is_unfinished(command, capsys, tmp_path, name):
    def write(args):
        with atomic_file(tmp_path / "a.txt") as partial:
            partial.write_text("half")
            os.kill(os.getpid(), number)

    number = getattr(signal, name)
    command(write)
    before = signal.getsignal(number)
    assert main(["fake"]) == 128 + number
    assert capsys.readouterr().err == f"t2m: error: interrupted by {name}\n"
    assert not list(tmp_path.iterdir()) and signal.getsignal(number) == before


def test_signals_raise_nothing_before_jax_is_imported(tmp_path):
    program = """
import importlib, os, signal
from t2m_jax.cli.main import main
load = importlib.import_module
def interrupted(name, *args):
    if name == "jax":
        os.kill(os.getpid(), signal.SIGTERM)
    return load(name, *args)
importlib.import_module = interrupted
main(["models"])
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (result.returncode, result.stdout, result.stderr) == (-signal.SIGTERM, "", "")


def test_a_signal_while_a_lock_file_is_created_leaves_no_lock(command, capsys, tmp_path, monkeypatch):
    """Python raises the exception as soon as the system call returns."""

    def interrupted(path, *args, create=os.open, **kwargs):
        descriptor = create(path, *args, **kwargs)
        if str(path).endswith(".lock"):
            signal.raise_signal(signal.SIGTERM)
        return descriptor

    def write(args):
        with monkeypatch.context() as patched:
            patched.setattr(os, "open", interrupted)
            with lock(tmp_path / "out"):
                time.sleep(10)

    command(write)
    handler = signal.getsignal(signal.SIGTERM)
    assert main(["fake"]) == 143
    assert capsys.readouterr().err == "t2m: error: interrupted by SIGTERM\n"
    assert signal.getsignal(signal.SIGTERM) == handler
    other = "import pathlib, sys; from t2m_jax.files.locks import lock; lock(pathlib.Path(sys.argv[1])).__enter__()"
    subprocess.run([sys.executable, "-c", other, f"{tmp_path / 'out'}"], check=True, timeout=60)
    with lock(tmp_path / "out"):
        pass
    assert not list(tmp_path.iterdir())


def test_config_options_reach_the_commands_that_take_them(command):
    seen = []
    command(seen.append, TAKES_CONFIG_OPTIONS=True)
    assert main(["fake", "a.yaml", "--train.lr", "1e-4", "--flag", "--widths", "1", "2", "--seed", "5"]) == 0
    assert (seen[0].text, seen[0].seed) == (["a.yaml"], 5)
    assert seen[0].config_options == ["--train.lr", "1e-4", "--flag", "--widths", "1", "2"]


def test_help_names_every_command_and_the_version_is_that_of_the_distribution(capsys):
    assert main([]) == 0
    without = capsys.readouterr().out
    assert main(["--help"]) == 0
    assert capsys.readouterr().out == without
    assert all(f"\n  {name} " in without for name in COMMANDS)
    assert "ONNX graphs or as a web page" in without
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"t2m_jax {importlib.metadata.version('t2m-jax')}\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    assert main([name, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"usage: t2m {name}")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_argument_has_help(name):
    def without_help(parser):
        children = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
        below = [words for action in children for child in action.choices.values() for words in without_help(child)]
        return below + [action.dest for action in parser._actions if action not in children and not action.help]

    parser = argparse.ArgumentParser(add_help=False)
    importlib.import_module(f"t2m_jax.cli.{name}").add_arguments(parser)
    assert without_help(parser) == []


def test_libraries_remark_in_vain_but_their_errors_are_shown():
    # In a process of its own: what pytest does to logging would hide what a user sees.
    program = """
import logging, sys, types
from t2m_jax.cli import main as program
def run(args):
    import absl.logging
    absl.logging.warning("hidden")
    absl.logging.error("hidden, because Orbax raises it, too")
    for name in ("jax._src.xla_bridge", "orbax.checkpoint"):
        logging.getLogger(name).warning("hidden")
        logging.getLogger(name).error("shown %s", name)
    logging.getLogger("t2m_jax.train").info("step 1")
fake = types.ModuleType("fake")
fake.add_arguments, fake.run = lambda parser: None, run
program.COMMANDS["fake"] = ""
sys.modules["t2m_jax.cli.fake"] = fake
sys.exit(program.main(["fake"]))
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == 0
    assert result.stderr.splitlines() == ["shown jax._src.xla_bridge", "shown orbax.checkpoint", "step 1"]


def test_a_reader_that_leaves_is_no_error():
    shell = f"{sys.executable} -m t2m_jax --help | head -c 1; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=False)
    assert result.returncode in (0, 141)
    assert (result.stdout, result.stderr) == ("u", "")


def test_view_turns_a_file_into_others(tmp_path, capsys):
    positions = np.random.default_rng(0).normal(size=(3, 22, 3)).astype(np.float32)
    np.savez(tmp_path / "in.npz", positions=positions, fps=20.0, caption="a person waves")
    outputs = [tmp_path / "out.npz", tmp_path / "out.html"]
    assert main(["view", f"{tmp_path}/in.npz", "-o", f"{outputs[0]}", "-o", f"{outputs[1]}"]) == 0
    assert capsys.readouterr().out.split() == [f"{output}" for output in outputs]
    np.testing.assert_array_equal(np.load(outputs[0])["positions"], positions)
    assert "a person waves" in Elements(outputs[1].read_text(encoding="utf-8")).data


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["missing.npz", "-o", "out.html"], "missing.npz"),
        (["in.npz", "-o", "out.xyz"], "out.xyz"),
        (["in.npz", "-o", "nowhere/out.npz"], "nowhere"),
        (["nan.npz", "-o", "out.npz"], "nan.npz"),
        (["broken.npz", "-o", "out.npz"], "broken.npz"),
        (["wide.npy", "-o", "out.npz"], "wide.npy"),
        (["in.txt", "-o", "out.npz"], "in.txt"),
    ],
)
def test_view_refuses_in_one_line(tmp_path, monkeypatch, capsys, arguments, named):
    monkeypatch.chdir(tmp_path)
    positions = np.zeros((3, 22, 3), np.float32)
    np.savez("in.npz", positions=positions, fps=20.0)
    np.savez("nan.npz", positions=positions * np.nan, fps=20.0)
    np.save("wide.npy", np.zeros((5, 100), np.float32))
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 no archive")
    (tmp_path / "in.txt").write_text("no motion")
    assert main(["view", *arguments]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("t2m: error: ")
    assert named in printed
    assert printed.count("\n") == 1


@pytest.mark.skipif(os.name == "nt", reason="uses pipes of POSIX")
@pytest.mark.parametrize("suffix", ["npz", "html", "bvh"])
def test_view_refuses_a_pipe_and_keeps_it(tmp_path, capsys, suffix):
    pipe = tmp_path / f"out.{suffix}"
    os.mkfifo(pipe)
    np.savez(tmp_path / "in.npz", positions=np.zeros((3, 22, 3), np.float32), fps=20.0)
    assert main(["view", f"{tmp_path / 'in.npz'}", "-o", f"{pipe}"]) == 2
    said = f"{pipe}: cannot be written, it is a pipe or device; give the name of a file"
    assert capsys.readouterr().err == f"t2m: error: {said}\n"
    assert pipe.is_fifo() and sorted(tmp_path.iterdir()) == [tmp_path / "in.npz", pipe]


def test_names_of_files_do_not_reach_the_terminal_as_they_are(capsys):
    show_next("t2m view 'a\x1b[31m.npz'")
    assert capsys.readouterr().err == "next: t2m view 'a\\x1b[31m.npz'\n"
    assert (
        comparison_table(["a\x1b[31m", "b\x07"], []).splitlines()[0]
        == r"| metric | a\x1b[31m | b\x07 | difference | p |"
    )


def test_names_in_a_data_set_do_not_reach_the_terminal_as_they_are(tmp_path, capsys):
    (tmp_path / "new_joint_vecs").mkdir()
    np.save(tmp_path / "Mean.npy", np.zeros(263, np.float32))
    (tmp_path / "train.txt").write_text("a\x1b[31m\n")
    assert main(["data", "check", f"{tmp_path}"]) == 1
    assert "\x1b" not in capsys.readouterr().out


def test_the_log_is_printable():
    record = logging.LogRecord("t2m_jax", logging.WARNING, "", 0, "clip %s", ("a\x1b[31m",), None)
    assert _PrintableFormatter("%(message)s").format(record) == r"clip a\x1b[31m"


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="uses a shell of POSIX")
@pytest.mark.parametrize("arguments", ["evaluate --help", "check demo"])
def test_a_closed_standard_output_is_no_error(arguments):
    command = f"{sys.executable} -m t2m_jax {arguments} >&-"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")
