"""Models of the hub: downloaded once, used without network, and refused if they are not complete."""

import dataclasses
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest
import yaml
from huggingface_hub import constants

from t2m_jax.checkpoints.bundle import save_bundle
from t2m_jax.checkpoints.hub import HubName, parse_hub_name
from t2m_jax.checkpoints.hub_models import BUNDLE_FILES, cached_models, find_model, load_card, push_bundle, push_model
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.text_encoder import SentenceReference
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.errors import UserError
from t2m_jax.files.manifest import MANIFEST, check_folder, write_manifest
from tests.hub_server import TOKEN
from tests.sentence_golden import BERT
from tests.tiny import BUNDLE, random_bundle

NAME = "someone/tiny"
OLD_PROTOCOL = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")
"""The client warns of its own upload if the server does not have its newest protocol."""
CARD = "---\nlicense: mit\n---\n# A tiny model\n"


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundles") / "tiny"
    save_bundle(folder, random_bundle(), card=CARD)
    return folder


@pytest.fixture
def copy(saved, tmp_path):
    return shutil.copytree(saved, tmp_path / "copy")


def refused(name=NAME, load=find_model) -> str:
    with pytest.raises(UserError) as caught:
        load(name)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(f"{name}: ")
    return str(caught.value)


def go_offline(monkeypatch):
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("user/name", HubName("user/name")),
        ("user/my-model.v2@v1.0", HubName("user/my-model.v2", "v1.0")),
        ("user/name@refs/pr/1", HubName("user/name", "refs/pr/1")),
    ],
)
def test_names_of_the_hub_have_a_user_and_maybe_a_revision(text, name):
    assert parse_hub_name(text) == name
    assert f"{name}" == text


@pytest.mark.parametrize(
    "text",
    [
        "demo",
        "./a/b",
        "/a/b",
        "~/b",
        "a/b/c",
        "a/b@",
        "a/b@../c",
        "a/b@v1/../../c",
        "a/b@/etc",
        "a/b@-x",
        "-a/b",
        "a b/c",
        "a/ü",
        "a/b\n",
    ],
)
def test_paths_are_not_names_of_the_hub(text):
    assert parse_hub_name(text) is None


def test_a_model_of_the_hub_is_that_of_its_bundle(hub, saved):
    commit = hub.add(NAME, saved)
    model = load_model(NAME)
    assert model.source == f"{NAME}@{commit}"
    jax.tree.map(np.testing.assert_array_equal, model.variables, load_model(saved).variables)
    assert load_tokenizer(NAME).fingerprint == load_tokenizer(saved).fingerprint


def test_only_files_of_bundles_are_downloaded_and_only_once(hub, copy):
    (copy / "official").mkdir()
    for name in ("pytorch_model.bin", "official/gpt.pth", "clip.py"):
        (copy / name).write_bytes(b"x" * 100)
    hub.add(NAME, copy)
    folder = find_model(NAME).folder
    assert hub.downloaded() == {MANIFEST} | {path.name for path in folder.iterdir()}
    assert hub.downloaded() <= {MANIFEST} | BUNDLE_FILES
    hub.asked.clear()
    assert find_model(NAME).folder == folder
    assert hub.asked == [f"GET /api/models/{NAME}"]


def test_the_newest_commit_is_used(hub, saved, tmp_path):
    hub.add(NAME, saved)
    find_model(NAME)
    save_bundle(tmp_path / "new", random_bundle(seed=11), card=CARD)
    new = hub.add(NAME, tmp_path / "new")
    assert find_model(NAME).folder.name == new
    weights = [folder / "weights.safetensors" for folder in (find_model(NAME).folder, tmp_path / "new")]
    assert weights[0].read_bytes() == weights[1].read_bytes()


def test_a_revision_is_a_branch_a_tag_or_a_commit(hub, saved, tmp_path):
    old = hub.add(NAME, saved)
    save_bundle(tmp_path / "new", random_bundle(seed=11), card=CARD)
    hub.add(NAME, tmp_path / "new")
    new = hub.add(NAME, tmp_path / "new", ref="v2")
    assert find_model(f"{NAME}@v2").source == f"{NAME}@{new}"
    assert find_model(f"{NAME}@{old}").folder.name == old
    hub.asked.clear()
    assert find_model(f"{NAME}@{old}").source == f"{NAME}@{old}"
    assert hub.asked == []  # a commit never changes
    assert "does not have this revision" in refused(f"{NAME}@v3")


def test_a_folder_comes_first_and_a_revision_means_the_hub(hub, saved, tmp_path, monkeypatch):
    commit = hub.add(NAME, saved)
    shutil.copytree(saved, tmp_path / NAME)
    monkeypatch.chdir(tmp_path)
    assert find_model(NAME) == (Path(NAME), NAME)
    assert hub.asked == []
    assert find_model(f"{NAME}@main").source == f"{NAME}@{commit}"
    assert hub.asked[0] == f"GET /api/models/{NAME}/revision/main"


def test_without_network_the_copy_is_used(hub, saved, monkeypatch, caplog):
    hub.add(NAME, saved)
    folder = find_model(NAME).folder
    go_offline(monkeypatch)
    hub.asked.clear()
    caplog.set_level("INFO")
    assert find_model(NAME).folder == folder
    assert load_card(NAME) == CARD
    assert hub.asked == []
    assert f"using the copy of commit {folder.name}" in caplog.text
    assert "HF_HUB_OFFLINE" in refused("someone/other")
    assert "HF_HUB_OFFLINE" in refused("someone/other", load_card)


def test_a_hub_that_does_not_answer_is_asked_once(hub, saved, monkeypatch):
    hub.add(NAME, saved)
    folder = find_model(NAME).folder
    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:1")
    assert find_model(NAME).folder == folder
    assert "there is no such folder, and it cannot be loaded from the hub: " in refused("runs/gpt")
    monkeypatch.setattr(constants, "ENDPOINT", hub.url)
    hub.asked.clear()
    assert "the hub has no model of this name" in refused("runs/gpt")
    assert hub.asked.count("GET /api/models/runs/gpt") == 1


def test_private_models_need_a_token(hub, saved, monkeypatch):
    hub.add(NAME, saved, private=True)
    assert "`hf auth login`" in refused()
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    assert find_model(NAME).folder.is_dir()


def change_card(folder, text):
    (folder / "README.md").write_text(text)
    write_manifest(folder)


def change_config(folder, **changes):
    data = yaml.safe_load((folder / "bundle.yaml").read_text()) | changes
    (folder / "bundle.yaml").write_text(
        yaml.safe_dump({key: value for key, value in data.items() if value is not None})
    )
    write_manifest(folder)


def delete(folder, name):
    (folder / name).unlink()
    if name != MANIFEST:
        write_manifest(folder)


def add_file(folder, name):
    (folder / name).write_text("{}")
    write_manifest(folder)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda folder: delete(folder, MANIFEST), "no checksums (manifest.txt)"),
        (lambda folder: delete(folder, "README.md"), "no card (README.md)"),
        (lambda folder: delete(folder, "bundle.yaml"), "is not a bundle"),
        (lambda folder: delete(folder, "weights.safetensors"), "weights.safetensors"),
        (lambda folder: change_card(folder, "# mine\n"), "no license in the metadata of README.md"),
        (lambda folder: change_card(folder, "---\nlicense: unknown\n---\n"), "no license in the metadata of README.md"),
        (lambda folder: change_config(folder, format_version=None), "format_version in bundle.yaml"),
        (lambda folder: change_config(folder, format_version=99), "format_version 99"),
        (lambda folder: add_file(folder, "run.yaml"), "no others: run.yaml"),
        (lambda folder: add_file(folder, "pytorch_model.bin"), "no others: pytorch_model.bin"),
        (lambda folder: (folder / "README.md").write_text(f"{CARD}more"), "README.md: has changed"),
    ],
)
def test_bundles_that_are_not_complete_are_refused_before_their_weights_are_downloaded(hub, copy, change, said):
    change(copy)
    hub.add(NAME, copy)
    assert said in refused()
    assert "weights.safetensors" not in hub.downloaded()
    assert list(cached_models()) == []


def test_weights_that_are_not_those_of_the_manifest_are_refused(hub, copy):
    whole = bytearray((copy / "weights.safetensors").read_bytes())
    whole[-1] ^= 1
    (copy / "weights.safetensors").write_bytes(whole)
    hub.add(NAME, copy)
    assert "weights.safetensors: has changed" in refused()
    assert "weights.safetensors: has changed" in refused()


def test_an_interrupted_download_is_not_loaded_and_is_continued(hub, saved, monkeypatch):
    hub.add(NAME, saved)
    hub.cut_after["weights.safetensors"] = 1000
    monkeypatch.setattr("huggingface_hub.utils._http.time.sleep", lambda seconds: None, raising=False)
    assert "cannot be downloaded" in refused()
    hub.cut_after.clear()
    assert list(cached_models()) == []
    with monkeypatch.context() as offline:
        go_offline(offline)
        refused()
    check_folder(find_model(NAME).folder)


def test_a_copy_without_one_of_its_files_is_completed(hub, saved):
    hub.add(NAME, saved)
    folder = find_model(NAME).folder
    (folder / "weights.safetensors").resolve().unlink()
    assert list(cached_models()) == []
    check_folder(find_model(NAME).folder)


def test_a_card_is_shown_without_downloading_the_model(hub, copy):
    change_card(copy, "# no license\n")
    hub.add(NAME, copy)
    assert load_card(NAME) == "# no license\n"
    assert "weights.safetensors" not in hub.downloaded()
    assert list(cached_models()) == []
    delete(copy, "README.md")
    hub.add("someone/other", copy)
    assert "it has no README.md on the hub" in refused("someone/other", load_card)


def test_models_that_are_kept_are_listed(hub, saved, tmp_path):
    assert list(cached_models()) == []
    old = hub.add(NAME, saved)
    hub.add("someone/other", saved, ref="v1")
    for name in (NAME, "someone/other@v1"):
        find_model(name)
    assert [model.source for model in cached_models()] == ["someone/other@v1", NAME]
    save_bundle(tmp_path / "new", random_bundle(seed=11), card=CARD)
    hub.add(NAME, tmp_path / "new")
    find_model(NAME)
    assert {model.source for model in cached_models()} == {"someone/other@v1", NAME, f"{NAME}@{old}"}


@OLD_PROTOCOL
def test_what_is_pushed_can_be_loaded(hub, copy, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    (copy / "notes.txt").write_text("not part of the bundle")
    url = push_bundle(copy, HubName(NAME))
    commit = hub.repositories[NAME].refs["main"]
    assert url == f"{hub.url}/{NAME}/tree/{commit}"
    assert "notes.txt" not in hub.files(NAME)
    check_folder(find_model(NAME).folder)
    (copy / "notes.txt").unlink()
    change_card(copy, f"{CARD}new\n")
    push_bundle(copy, HubName(NAME, "v2"))
    assert load_card(NAME) == CARD
    assert load_card(f"{NAME}@v2") == f"{CARD}new\n"
    push_bundle(copy, HubName(NAME, "v2"))  # the branch exists


@OLD_PROTOCOL
def test_a_text_encoder_goes_with_its_model_and_folders_of_this_machine_do_not(hub, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    generator = dataclasses.replace(BUNDLE.generator, text_dim=24)
    reader = SentenceReference(name=f"{BERT}")
    push_model(random_bundle(dataclasses.replace(BUNDLE, generator=generator, text_encoder=reader)), NAME, card=CARD)
    assert f"{BERT}".encode() not in hub.files(NAME)["bundle.yaml"]
    assert load_model(NAME).config.text_encoder.name == f"{find_model(NAME).folder / 'sentence'}"


@OLD_PROTOCOL
def test_private_repositories_are_not_mistaken_for_public_ones(hub, saved, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    push_bundle(saved, HubName(NAME), private=True)
    assert hub.repositories[NAME].private
    hub.add("someone/public", saved)
    before = dict(hub.files("someone/public"))
    with pytest.raises(UserError, match=r"someone/public: was not pushed \(it exists already and is public"):
        push_bundle(saved, HubName("someone/public"), private=True)
    assert hub.files("someone/public") == before


@pytest.mark.parametrize("card", ["# mine\n", "---\nlicense: unknown\n---\n", None])
def test_nothing_is_pushed_without_a_license(hub, copy, monkeypatch, card):
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    delete(copy, "README.md") if card is None else change_card(copy, card)
    with pytest.raises(UserError, match=rf"{copy}: refused, because it has no"):
        push_bundle(copy, HubName(NAME))
    assert hub.asked == []


def test_nothing_is_pushed_that_is_damaged_or_by_somebody_unknown(hub, copy):
    with pytest.raises(UserError, match=rf"{NAME}: was not pushed \(.*log in .*t2m bundle .* --push {NAME}"):
        push_bundle(copy, HubName(NAME))
    (copy / "Mean.npy").write_bytes(b"")
    hub.asked.clear()
    with pytest.raises(UserError, match=r"Mean\.npy: has changed"):
        push_bundle(copy, HubName(NAME))
    assert hub.asked == [] and hub.repositories == {}
