"""Repositories of the Hugging Face hub: their names, their files, and copies of them on this machine."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from t2m_jax.errors import UserError
from t2m_jax.files.reading import first_line

SECONDS = 10
"""Longest wait for the first answer of the hub. After it, a copy on this machine is used."""
# A revision may be a path such as `refs/pr/1`. It becomes a path in the client's folder, so it must not contain `..`.
_NAME = re.compile(r"([A-Za-z0-9][\w.-]*/[\w.-]+)(?:@(?!.*\.\.)(\w[\w./-]*))?", re.ASCII)


class HubName(NamedTuple):
    """A repository of the hub, `user/name`, at one of its revisions."""

    repository: str
    revision: str | None = None
    """Branch, tag or commit; None for the newest."""

    def __str__(self) -> str:
        """Returns the name as users write it: `user/name` or `user/name@revision`."""
        return self.repository if self.revision is None else f"{self.repository}@{self.revision}"


def parse_hub_name(name: str | Path) -> HubName | None:
    """Returns the parts of a name of the hub, None if a text cannot be one. A `Path` never is."""
    found = _NAME.fullmatch(name) if isinstance(name, str) else None
    return None if found is None else HubName(found[1], found[2])


def hub_name(text: str) -> HubName:
    """Returns the parts of a name of the hub.

    Raises:
        UserError: A text cannot be one.
    """
    name = parse_hub_name(text)
    if name is None:
        raise UserError(f"{text} is not a name on the hub; give user/name or user/name@branch")
    return name


def hub_commit(name: HubName) -> str:
    """Returns the commit that a repository has now.

    Raises:
        UserError: The hub cannot be reached, or has no such repository or revision for this user. The message is only
            the reason.
    """
    import huggingface_hub  # slow to import, and only names of the hub need it

    try:
        info = huggingface_hub.HfApi().model_info(name.repository, revision=name.revision, timeout=SECONDS)
    except Exception as error:  # noqa: BLE001 - the client passes on whatever its HTTP library raises
        raise UserError(hub_reason(error)) from None
    return f"{info.sha}"


def hub_snapshot(name: HubName, files: Sequence[str], *, offline: bool = False) -> Path:
    """Returns the folder in which the hub's client keeps a revision, with the files of these names that exist.

    Args:
        name: The repository.
        files: Names of files; those that are missing on this machine are downloaded.
        offline: Nothing is downloaded. The folder may then be incomplete.

    Raises:
        UserError: The files cannot be downloaded; with `offline`, nothing is kept. The message is only the reason.
    """
    import huggingface_hub

    try:
        folder = huggingface_hub.snapshot_download(
            name.repository,
            revision=name.revision,
            # Without a list, everything would be downloaded, code and pickles included.
            allow_patterns=list(files),
            local_files_only=offline,
        )
    except Exception as error:  # noqa: BLE001 - see `hub_commit`
        raise UserError(hub_reason(error)) from None
    return Path(folder)


def hub_reason(error: Exception) -> str:
    """Returns in one line why the hub refused something."""
    from huggingface_hub import errors

    login = "log in with `hf auth login` or set HF_TOKEN"
    if isinstance(error, errors.OfflineModeIsEnabled):
        return "HF_HUB_OFFLINE is set"
    if isinstance(error, errors.GatedRepoError):
        return f"its authors must give you access to it; ask on its page, then {login}"
    if isinstance(error, errors.RepositoryNotFoundError):
        return f"the hub has no model of this name; if it is private, {login}"
    if isinstance(error, errors.RevisionNotFoundError):
        return "the hub does not have this revision of it"
    if isinstance(error, RuntimeError) and isinstance(error.__cause__, Exception):
        return f"{first_line(error)} {hub_reason(error.__cause__)}"  # of an upload, which hides its cause
    status = getattr(getattr(error, "response", None), "status_code", None)
    return f"{first_line(error)}; {login}" if status in (401, 403) else first_line(error)
