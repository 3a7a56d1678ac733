"""`t2m --completion SHELL`, in a real shell."""

import shutil
import subprocess

import pytest

from t2m_jax.cli.completion import SHELLS
from t2m_jax.cli.main import COMMANDS, main

WORDS = {
    "t2m gen": ["generate"],
    "t2m generate --see": ["--seed"],
    "t2m data im": ["import"],
    "t2m view READ": ["README.md"],
    "t2m check mo": ["model"],
}
"""What is typed, and what it is completed to where a file `README.md` and a folder `model` are."""


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_commands_options_and_files(tmp_path, capsys):
    assert main(["--completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)
    folder = tmp_path / "here"
    (folder / "model").mkdir(parents=True)
    (folder / "README.md").touch()
    for typed, expected in WORDS.items():
        count = len(typed.split())
        steps = f'source "{script}"; COMP_WORDS=({typed}); COMP_CWORD={count - 1}; _shtab_t2m; echo "${{COMPREPLY[@]}}"'
        found = subprocess.run(["bash", "-c", steps], cwd=folder, capture_output=True, text=True, check=True)
        assert found.stdout.split() == expected, (typed, found.stderr)


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_of_each_shell_knows_all_commands(shell, capsys):
    assert main(["--completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(command in script for command in COMMANDS)


def test_another_shell_is_refused_in_one_line(capsys):
    assert main(["--completion", "cmd"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
