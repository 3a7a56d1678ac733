"""Pretrained text encoders by a folder or by their name on the Hugging Face hub.

Only files with known names are downloaded, and none of them can run code.
"""

import importlib.resources
from pathlib import Path
from textwrap import shorten
from typing import NamedTuple

import platformdirs

from t2m_jax.checkpoints.hub import HubName, hub_snapshot, parse_hub_name
from t2m_jax.errors import UserError

PACKAGED_ENCODERS = ("minilm",)
"""Names of the sentence encoders that are part of the package."""


class EncoderFiles(NamedTuple):
    """The files of one kind of text encoder."""

    kind: str
    """Name of the folder with the user's own copies."""
    wanted: str
    """What the user may give, for messages."""
    required: tuple[str, ...]
    """Files that each model has."""
    weights: tuple[str, ...]
    """Files of the weights: one of them, in the order in which they are tried."""
    optional: tuple[str, ...] = ()
    """Files that a model may have."""


def find_encoder(name_or_folder: str | Path, files: EncoderFiles) -> Path:
    """Returns the folder of a text encoder.

    The first of these is used: a sentence encoder of the package; the folder with this path; the user's copy in
    `user_folder`; the hub's cache on this machine; a download from the hub. A name may end with a revision:
    `owner/name@revision`.

    Raises:
        UserError: There is no such folder, and the hub name cannot be downloaded.
    """
    if str(name_or_folder) in PACKAGED_ENCODERS and files.kind == "sentence":
        return Path(str(importlib.resources.files("t2m_jax") / "encoders" / str(name_or_folder)))
    if Path(name_or_folder).is_dir():
        return Path(name_or_folder)
    name = str(name_or_folder)
    hub_name = parse_hub_name(name_or_folder)
    if hub_name is None:
        raise UserError(f"{name}: no such folder; give {files.wanted}")
    folder = user_folder(name, files.kind)
    return folder if folder.is_dir() else _hub_snapshot(hub_name, files)


def user_folder(name: str, kind: str) -> Path:
    """Returns the folder into which a user may put the files of a hub name by hand."""
    return Path(platformdirs.user_data_dir("t2m_jax")) / kind / name.replace("/", "--")


def _hub_snapshot(name: HubName, files: EncoderFiles) -> Path:
    """Returns the folder in which the hub's client keeps an encoder; downloads one weight format if necessary."""
    reason = ""
    others = [*files.required, *files.optional]
    # First without network, in all formats: what is on this machine needs no request, which may take long or fail.
    for offline in (True, False):
        for weights in files.weights:
            try:
                folder = hub_snapshot(name, [*others, weights], offline=offline)
            except UserError as error:
                reason = str(error)
                if offline:
                    continue
                # The hub cannot be reached, or has no such model. Another format would not help.
                break
            # The snapshot may be partial.
            missing = [file for file in (*files.required, weights) if not (folder / file).is_file()]
            if not missing:
                return folder
            reason = f"it has no {missing[0]}"
    page = f"https://huggingface.co/{name.repository}/tree/{name.revision or 'main'}"
    raise UserError(
        f"{name}: no folder, and not on the hub ({shorten(reason, 30)}); copy {', '.join(files.required)} "
        f"and {' or '.join(files.weights)} from {page} into {user_folder(str(name), files.kind)}"
    )
