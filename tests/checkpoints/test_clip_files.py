"""Where a CLIP is looked for: a folder, the user's own folder, the hub's cache, the hub."""

import shutil
import socket

import huggingface_hub
import platformdirs
import pytest
from huggingface_hub import constants

from t2m_jax.checkpoints.clip import CLIP_FILES, load_clip
from t2m_jax.checkpoints.encoder_files import find_encoder, user_folder
from t2m_jax.errors import UserError
from tests.clip_golden import FULL, SAFETENSORS, TEXT_ONLY, TORCH, copy_files

NAME = "someone/tiny-clip"


@pytest.fixture(autouse=True)
def places(monkeypatch, tmp_path):
    """Gives every test empty folders of its own and a network that must not be touched."""
    monkeypatch.setattr(platformdirs, "user_data_dir", lambda name: str(tmp_path / "data" / name))
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)

    def refuse(*arguments, **options):
        raise AssertionError("the network was touched")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)


def cached_snapshot(tmp_path, *, source=FULL, revision="main", **files):
    """Returns a folder as the hub's client leaves it."""
    repository, commit = tmp_path / "hub" / f"models--{NAME.replace('/', '--')}", f"{len(revision):040x}"
    (repository / "refs").mkdir(parents=True, exist_ok=True)
    (repository / "refs" / revision).write_text(commit)
    return copy_files(source, repository / "snapshots" / commit, **files)


def refused(name) -> str:
    with pytest.raises(UserError) as caught:
        load_clip(name)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_folder_is_itself():
    assert find_encoder(FULL, CLIP_FILES) == FULL
    assert find_encoder(str(FULL), CLIP_FILES) == FULL


def test_a_folder_named_like_the_hub_comes_first(monkeypatch, tmp_path):
    shutil.copytree(FULL, tmp_path / NAME)
    monkeypatch.chdir(tmp_path)
    assert load_clip(NAME).config == load_clip(FULL).config


@pytest.mark.parametrize(
    "name", ["no-such-folder", "./no/such", "/no/such/folder", "a/b/c", "nothing here", "~/clip", "-a/b"]
)
def test_a_folder_that_is_not_there_is_named(name):
    assert f"{name}: no such folder" in refused(name)


def test_a_path_is_never_a_hub_name(tmp_path):
    assert "no such folder" in refused(tmp_path / "nobody" / "nothing")


def test_offline_the_error_says_what_to_download_and_where_to_put_it():
    message = refused(NAME)
    for part in (NAME, "config.json", "tokenizer.json", SAFETENSORS, TORCH):
        assert part in message
    assert f"https://huggingface.co/{NAME}/tree/main" in message
    assert str(user_folder(NAME, "clip")) in message


def test_what_the_user_put_there_is_found():
    copy_files(FULL, user_folder(NAME, "clip"), weights=TORCH)
    assert load_clip(NAME).fingerprint
    (user_folder(NAME, "clip") / TORCH).unlink()
    assert str(user_folder(NAME, "clip")) in refused(NAME)


@pytest.mark.parametrize("weights", [SAFETENSORS, TORCH])
def test_what_the_hubs_client_has_kept_is_found(weights, tmp_path):
    snapshot = cached_snapshot(tmp_path, weights=weights)
    assert find_encoder(NAME, CLIP_FILES) == snapshot
    assert load_clip(NAME).fingerprint == load_clip(FULL).fingerprint


def test_a_name_may_have_a_revision(tmp_path):
    newest = cached_snapshot(tmp_path)
    older = cached_snapshot(tmp_path, source=TEXT_ONLY, revision="v1")
    assert (find_encoder(NAME, CLIP_FILES), find_encoder(f"{NAME}@v1", CLIP_FILES)) == (newest, older)
    assert f"https://huggingface.co/{NAME}/tree/v2 into" in refused(f"{NAME}@v2")


@pytest.mark.parametrize("missing", ["config.json", SAFETENSORS, "tokenizer.json"])
def test_a_snapshot_that_is_not_complete_is_not_taken(missing, tmp_path):
    (cached_snapshot(tmp_path) / missing).unlink()
    assert f"https://huggingface.co/{NAME}" in refused(NAME)


@pytest.fixture
def hub(monkeypatch, tmp_path):
    """Returns what is downloaded from a hub that has a CLIP in one of the formats, and each time it is asked."""
    downloads = []

    def download(name, *, allow_patterns, local_files_only, **options):
        folder = tmp_path / "downloaded"
        if local_files_only and not folder.exists():
            raise FileNotFoundError("nothing is kept here")
        if not local_files_only:
            downloads.append("asked")
        folder.mkdir(exist_ok=True)
        for file in (FULL / pattern for pattern in allow_patterns if pattern != SAFETENSORS):
            if not local_files_only and file.exists() and not (folder / file.name).exists():
                shutil.copy(file, folder)
                downloads.append(file.name)
        return str(folder)

    monkeypatch.setattr(huggingface_hub, "snapshot_download", download)
    return downloads


def test_one_format_is_downloaded_and_only_once(hub):
    assert load_clip(NAME).fingerprint == load_clip(FULL).fingerprint
    # Twice: for the format it does not have, and for the next.
    assert sorted(hub) == sorted(["asked", "asked", "config.json", "tokenizer.json", TORCH])
    hub.clear()
    load_clip(NAME)
    assert hub == []


def test_a_hub_that_cannot_be_reached_is_asked_once(monkeypatch):
    asked = []

    def download(name, *, local_files_only, **options):
        asked.append(local_files_only)
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", download)
    assert "(first line)" in refused(NAME)
    assert asked.count(False) == 1
