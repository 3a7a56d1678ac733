"""Commands with models of the hub: `--model user/name`, `t2m models`, `t2m bundle --push`."""

import os
import subprocess
import sys

import pytest

import t2m_jax
from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.sampling import TextToMotion
from tests.hub_server import TOKEN
from tests.tiny import random_bundle

NAME = "someone/tiny"
CARD = "---\nlicense: mit\n---\n# A tiny \x1b[31mmodel\n"


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shared") / "tiny"
    save_bundle(folder, random_bundle(), card=CARD)
    return folder


@pytest.mark.slow
def test_motion_is_generated_by_name_and_revision(hub, shared, tmp_path, caplog):
    caplog.set_level("INFO", "t2m_jax")
    hub.add(NAME, shared)
    commit = hub.add(NAME, shared, ref="v1")
    assert main(["generate", "walk", "-o", f"{tmp_path / 'walk.bvh'}", "--model", f"{NAME}@v1"]) == 0
    assert (tmp_path / "walk.bvh").is_file()
    assert caplog.messages == [f"{NAME}@v1: downloading commit {commit} from the hub"]


def test_python_loads_by_name_and_says_where_a_model_is_from(hub, shared):
    commit = hub.add(NAME, shared)
    assert f"source: {NAME}@{commit}\n" in repr(t2m_jax.load(NAME))


@pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")
def test_python_pushes_a_loaded_model_and_loads_it_again(hub, shared, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    model = TextToMotion.from_pretrained(shared)
    assert model.push_to_hub(NAME, private=True).startswith(f"{hub.url}/{NAME}/tree/")
    assert hub.repositories[NAME].private
    again = TextToMotion.from_pretrained(NAME)
    assert again.fingerprint == model.fingerprint
    assert (again.license, again.training_data) == (model.license, model.training_data)


def test_python_pushes_no_model_without_a_license_or_a_name(hub):
    model = TextToMotion(random_bundle())
    with pytest.raises(UserError, match=f"{NAME}: the model has no license; give a card"):
        model.push_to_hub(NAME)
    with pytest.raises(UserError, match="tiny is not a name on the hub"):
        model.push_to_hub("tiny", card=CARD)
    with pytest.raises(UserError, match=rf"{NAME}: was not pushed \(.*log in with `hf auth login` or set HF_TOKEN\)$"):
        model.push_to_hub(NAME, card=CARD)
    assert hub.repositories == {}


def test_downloaded_models_are_listed_after_the_packaged_ones(hub, shared, capsys):
    hub.add(NAME, shared)
    assert main(["models", NAME]) == 0
    assert capsys.readouterr().out == CARD.replace("\x1b", "\\x1b")
    assert main(["models"]) == 0
    assert NAME not in capsys.readouterr().out
    t2m_jax.load(NAME)
    assert main(["models"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"{NAME}: A tiny \\x1b[31mmodel (mit)"


@pytest.mark.parametrize("command", [["generate", "walk", "--model"], ["models"], ["evaluate", "prompts", "--model"]])
def test_a_wrong_path_is_one_line_about_the_folder_and_the_hub(hub, refusal, command):
    line = refusal(*command, "runs/gpt")
    assert "runs/gpt: there is no such folder, and it cannot be loaded from the hub: the hub has no model" in line
    assert hub.asked.count("GET /api/models/runs/gpt") == 1


@pytest.mark.slow
def test_the_address_of_a_hub_is_that_of_the_environment(hub, shared, tmp_path):
    hub.add(NAME, shared)
    command = [sys.executable, "-m", "t2m_jax", "models", NAME]
    done = subprocess.run(
        command, env=os.environ | hub.settings(tmp_path / "home"), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("# A tiny \\x1b[31mmodel\n")
    assert "HTTP" not in done.stderr  # the client logs its requests


@pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")
def test_a_bundle_is_pushed_and_the_next_command_loads_it(hub, shared, monkeypatch, capsys):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    assert main(["bundle", f"{shared}", "--push", f"{NAME}@v1", "--private"]) == 0
    said = capsys.readouterr()
    assert said.out == f"{hub.url}/{NAME}/tree/{hub.repositories[NAME].refs['v1']}\n"
    assert said.err.endswith(f"next: t2m generate 'a person walks forward' --model {NAME}@v1\n")
    assert hub.repositories[NAME].private
    assert hub.files(NAME, "v1")["README.md"] == CARD.encode()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["FOLDER"], "only --push takes a bundle alone"),
        (["FOLDER", "--push", "tiny"], "tiny is not a name on the hub"),
        (["FOLDER", "--push", NAME, "--card", "card.md"], "only --push takes a bundle alone"),
        (["run", "FOLDER", "--private"], "--private: is for --push"),
        (["no/such", "--push", NAME], "no/such: is not a bundle"),
    ],
)
def test_what_cannot_be_pushed_is_refused(hub, refusal, bundle_folder, arguments, said):
    assert said in refusal("bundle", *[f"{bundle_folder}" if word == "FOLDER" else word for word in arguments])
    assert hub.asked == []
