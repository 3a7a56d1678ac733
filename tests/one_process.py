"""Runs commands of `t2m` and Python programs in one process, which imports everything once and compiles it once.

Each line of the input is a JSON list: `sh` or `python`, and the code. The answer is a line with the exit code. What the
code prints goes to the standard error. The process runs where only the package is installed, so it imports no tests.
Tests start it with `shared_process`.
"""

import contextlib
import gc
import json
import os
import shlex
import subprocess
import sys
import traceback

import jax

from t2m_jax.cli.main import main

MAX_COMMANDS = 20
"""Commands after which compiled programs are dropped, which would take gigabytes."""


def run(language: str, code: str) -> int:
    """Returns the exit code of a command, or of a program."""
    if language == "sh":
        return main(shlex.split(code)[1:])
    try:
        exec(compile(code, "<page>", "exec"), {"__name__": "__main__"})  # noqa: S102 - code of our own pages
    except Exception:  # noqa: BLE001 - whatever it is, it is printed as Python does
        traceback.print_exc()
        return 1
    return 0


@contextlib.contextmanager
def shared_process(python, folder, environment, log):
    """Gives the body a function that runs code in a process for all, and returns the exit code as a text."""
    options = {"cwd": folder, "env": environment, "stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": log}
    with subprocess.Popen([python, "-P", __file__], text=True, **options) as process:

        def run(language, code):
            process.stdin.write(json.dumps([language, code]) + "\n")
            process.stdin.flush()
            return process.stdout.readline().strip()

        yield run


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)
        for number, line in enumerate(sys.stdin, start=1):
            answers.write(f"{run(*json.loads(line))}\n")
            answers.flush()
            if number % MAX_COMMANDS == 0:
                jax.clear_caches()
                gc.collect()
