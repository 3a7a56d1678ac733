"""Models on the Hugging Face hub: found by a name such as `user/name@v1`, refused if they are not complete, pushed.

A repository of the hub contains the files of a bundle. Of all its files, only those that a bundle can have are
downloaded, so that none of them can run code.
"""

import contextlib
import dataclasses
import logging
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from t2m_jax.checkpoints import bundle
from t2m_jax.checkpoints.clip import CLIP_FILES
from t2m_jax.checkpoints.hub import HubName, hub_commit, hub_name, hub_reason, hub_snapshot, parse_hub_name
from t2m_jax.checkpoints.run import DATA_FILE, is_run
from t2m_jax.checkpoints.sentence import SENTENCE_FILES
from t2m_jax.checkpoints.text_encoder import included_encoder, pretrained_reference, with_encoder_name
from t2m_jax.errors import UserError, naming
from t2m_jax.files.manifest import MANIFEST, check_folder, has_manifest, read_manifest
from t2m_jax.files.reading import load_text
from t2m_jax.motion.normalizer import MEAN_FILE, STD_FILE
from t2m_jax.text.bpe import TOKENIZER_FILE
from t2m_jax.yaml_file import load_yaml

logger = logging.getLogger(__name__)

DESCRIPTION_FILES = (MANIFEST, bundle.CONFIG_FILE, bundle.CARD_FILE)
"""The small files that say what a bundle is. They are checked before the others are downloaded."""
BUNDLE_FILES = frozenset(
    {bundle.CONFIG_FILE, bundle.CARD_FILE, bundle.WEIGHTS_FILE, DATA_FILE, MEAN_FILE, STD_FILE, TOKENIZER_FILE}
    | {
        f"{files.kind}/{name}"
        for files in (CLIP_FILES, SENTENCE_FILES)
        for name in (*files.required, files.weights[0], *files.optional)
    }
)
"""What the manifest of a bundle may list."""
_LICENSED = "---\nlicense: mit\n---\n"
"""A card with a license."""


class FoundModel(NamedTuple):
    """The folder of a model, and where it comes from."""

    folder: Path
    source: str
    """The name or path as given; for a model of the hub, its name with the commit: `user/name@0123…`."""


def find_model(name_or_path: str | Path) -> FoundModel:
    """Returns the folder of a packaged name, of a path, or of a name on the hub, which is downloaded if necessary.

    A folder comes before the repository of the hub that has the same name. Without network, the newest copy on this
    machine is used.

    Raises:
        UserError: The hub has no such model, or cannot be reached; or the model is damaged or lacks what all models of
            the hub must have.
    """
    folder = bundle.bundle_path(name_or_path)
    name = parse_hub_name(name_or_path)
    if name is None or folder.exists():
        return FoundModel(folder, f"{name_or_path}")
    copy = _newest_copy(name)
    _check_copy(name, copy)
    return FoundModel(copy, f"{name.repository}@{copy.name}")


def load_card(name_or_path: str | Path) -> str:
    """Returns the card of a bundle; if it is on the hub, nothing else is downloaded.

    Raises:
        UserError: There is no such bundle, or it has no card.
    """
    folder = bundle.bundle_path(name_or_path)
    name = parse_hub_name(name_or_path)
    if name is None and not folder.is_dir():
        raise UserError(f"{name_or_path}: no such model; known: {', '.join(bundle.BUNDLED)}, or the folder of a bundle")
    if name is None or folder.exists():
        return load_text(folder / bundle.CARD_FILE)
    copy = _find_copy(name)
    commit = _newest_commit(name, copy)
    if copy is None or copy.name != commit:
        copy = _download(name, DESCRIPTION_FILES, revision=commit)
    if not (copy / bundle.CARD_FILE).is_file():
        raise UserError(f"{name}: is not a bundle of t2m_jax, because it has no {bundle.CARD_FILE} on the hub")
    return load_text(copy / bundle.CARD_FILE)


def cached_models() -> Iterator[FoundModel]:
    """Yields the complete models of the hub that are on this machine."""
    import huggingface_hub
    from huggingface_hub import constants, errors

    try:
        repositories = huggingface_hub.scan_cache_dir(constants.HF_HUB_CACHE).repos
    except (errors.CacheNotFound, ValueError):  # `ValueError`: it is not a folder
        return
    for repository in sorted(repositories, key=lambda repository: repository.repo_id):
        for revision in sorted(repository.revisions, key=lambda revision: -revision.last_modified):
            ref = None if "main" in revision.refs else min(revision.refs, default=revision.commit_hash)
            with contextlib.suppress(UserError):
                # The client's folder is shared by all programs, and most of its models are none of ours.
                check_shareable(revision.snapshot_path)
                if repository.repo_type == "model" and _is_complete(revision.snapshot_path):
                    yield FoundModel(revision.snapshot_path, f"{HubName(repository.repo_id, ref)}")


def check_shareable(folder: Path) -> None:
    """Raises `UserError` if a bundle lacks what users of the hub need: checksums, a version, a card with a license."""
    if not (folder / bundle.CONFIG_FILE).is_file() or is_run(folder):
        raise UserError(f"is not a bundle of t2m_jax (a bundle has {bundle.CONFIG_FILE} and is not a run)")
    card = load_text(folder / bundle.CARD_FILE) if (folder / bundle.CARD_FILE).is_file() else None
    lacks = {
        f"checksums ({MANIFEST})": not has_manifest(folder),
        f"format_version in {bundle.CONFIG_FILE}": "format_version" not in load_yaml(folder / bundle.CONFIG_FILE).data,
        f"card ({bundle.CARD_FILE})": card is None,
        f"license in the metadata of {bundle.CARD_FILE}": card is not None
        and bundle.card_license(card) == bundle.NO_LICENSE,
    }
    if any(lacks.values()):
        missing = ", ".join(name for name, is_missing in lacks.items() if is_missing)
        raise UserError(f"refused, because it has no {missing}; its authors can add this with `t2m bundle --card FILE`")
    bundle.load_bundle_config(folder)
    listed = read_manifest(folder).keys()
    if wrong := listed - BUNDLE_FILES or {bundle.CONFIG_FILE, bundle.CARD_FILE, bundle.WEIGHTS_FILE} - listed:
        raise UserError(f"refused, because {MANIFEST} must list the files of a bundle and no others: {min(wrong)}")


def push_model(
    model: bundle.Bundle, name: str, *, card: str | None = None, private: bool = False, half: bool = True
) -> str:
    """Uploads a model to a repository of the hub, which is created if it does not exist. Returns the address.

    A pretrained text encoder goes with it, unless it is part of the package.

    Args:
        model: The model.
        name: `user/name` or `user/name@branch`.
        card: Markdown with a license in its metadata; by default the model's own card.
        private: Whether only you can see the repository.
        half: As in `save_bundle`.

    Raises:
        UserError: There is no license, `name` is not a name of the hub, or the hub refuses the model.
    """
    place = hub_name(name)
    card = model.card if card is None else card
    if bundle.card_license(card) == bundle.NO_LICENSE:
        raise UserError(f"{name}: the model has no license; give a card that begins with {_LICENSED!r}")
    reference = pretrained_reference(model.config.text_encoder)
    encoder = included_encoder(model.config.text_encoder)
    # The name of a folder of this machine says nothing to others.
    if reference is not None and encoder is not None and Path(reference.name).is_dir():
        named = with_encoder_name(model.config.text_encoder, type(reference)().name)
        model = model._replace(config=dataclasses.replace(model.config, text_encoder=named))
    with tempfile.TemporaryDirectory() as folder:
        bundle.write_bundle(Path(folder), model, card=card, half=half, encoder=encoder)
        return _upload(Path(folder), place, private=private)


def push_bundle(folder: Path, name: HubName, *, private: bool = False) -> str:
    """Uploads a bundle to a repository of the hub, which is created if it does not exist. Returns the address.

    Only the bundle's own files are uploaded, in one commit. With a revision, they go to the branch of this name.

    Raises:
        UserError: The bundle is damaged or lacks a license; or the hub refuses it.
    """
    with naming(folder):
        check_shareable(folder)
    # Users check SHA-256 of what they download. Damage must show here, not there.
    check_folder(folder, thorough=True)
    try:
        return _upload(folder, name, private=private)
    except UserError as error:
        raise UserError(f"{error}; to try again: t2m bundle {folder} --push {name}") from None


def _upload(folder: Path, name: HubName, *, private: bool) -> str:
    """Uploads the files of a complete bundle."""
    import huggingface_hub

    api = huggingface_hub.HfApi()
    files = [MANIFEST, *read_manifest(folder)]
    try:
        url = api.create_repo(name.repository, private=private or None, exist_ok=True)
        # `exist_ok` also accepts a repository that is public, and leaves it so.
        if private and not api.model_info(name.repository).private:
            raise UserError(f"it exists already and is public; make it private on {url} first")
        if name.revision is not None:
            api.create_branch(name.repository, branch=name.revision, exist_ok=True)
        commit = api.upload_folder(
            repo_id=name.repository,
            folder_path=folder,
            allow_patterns=files,
            revision=name.revision,
            commit_message="Upload a bundle of t2m_jax",
        )
    except Exception as error:  # noqa: BLE001 - see `hub_commit`
        raise UserError(f"{name}: was not pushed ({hub_reason(error)})") from None
    return f"{url}/tree/{commit.oid}"


def _find_copy(name: HubName) -> Path | None:
    """Returns the newest copy on this machine; None if there is none, or not all of its files."""
    with contextlib.suppress(UserError):
        folder = hub_snapshot(name, [MANIFEST], offline=True)
        if _is_complete(folder):
            return folder
    return None


def _is_complete(folder: Path) -> bool:
    """Returns whether all files of a bundle are there, which is not so if a download was interrupted."""
    return all((folder / name).is_file() for name in read_manifest(folder))


def _check_copy(name: HubName, folder: Path, *, only: tuple[str, ...] | None = None) -> None:
    """Raises `UserError` if files of a bundle (by default all) are damaged, or it lacks what it must have."""
    try:
        check_shareable(folder)
        check_folder(folder, only=only, thorough=True)
    except UserError as error:
        place = "" if only else f" (its copy is in {folder.parents[1]})"
        raise UserError(f"{name}: {error}{place}".replace(f"{folder}/", "")) from None


def _newest_commit(name: HubName, copy: Path | None) -> str:
    """Returns the commit that the hub has now; if it cannot be asked, that of the copy."""
    if copy is not None and copy.name == name.revision:  # a commit never changes
        return copy.name
    try:
        return hub_commit(name)
    except UserError as error:
        if copy is None:
            raise UserError(f"{name}: there is no such folder, and it cannot be loaded from the hub: {error}") from None
        logger.info("%s: the hub cannot be asked (%s); using the copy of commit %s", name, error, copy.name)
        return copy.name


def _newest_copy(name: HubName) -> Path:
    """Returns the folder with the commit that the hub has now, or the copy here if the hub cannot be asked."""
    copy = _find_copy(name)
    commit = _newest_commit(name, copy)
    if copy is not None and copy.name == commit:
        return copy
    # First the small files: what is not a bundle is refused before gigabytes are downloaded.
    folder = _download(name, DESCRIPTION_FILES, revision=commit)
    _check_copy(name, folder, only=DESCRIPTION_FILES)
    logger.info("%s: downloading commit %s from the hub", name, commit)
    # By its name, not by the commit: the client then notes which commit it is, and finds it without network. If the hub
    # has a newer commit by now, the check of all files shows it.
    return _download(name, [MANIFEST, *read_manifest(folder)], revision=name.revision)


def _download(name: HubName, files: Sequence[str], *, revision: str | None) -> Path:
    try:
        return hub_snapshot(name._replace(revision=revision), files)
    except UserError as error:
        raise UserError(f"{name}: cannot be downloaded ({error})") from None
