"""A stand-in for the Hugging Face hub: a server on this machine that speaks the part of its API which the client uses.

The client itself is the real one. It is only told the address of the server and an empty folder for its copies.
"""

import base64
import contextlib
import hashlib
import json
import re
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

MAX_REQUESTS = 300
"""Requests of one test, far more than any needs. A client that asks again and again fails."""
TOKEN = "hf_secret"


class Repository:
    """A repository: the files of each commit, and the commits that its branches and tags name."""

    def __init__(self, *, private: bool = False):
        self.private, self.commits, self.refs = private, {}, {}
        self.commit({".gitattributes": b""})

    def commit(self, files: dict[str, bytes], *, ref: str = "main") -> str:
        """Adds files to the newest commit of a branch, and returns the new commit."""
        whole = self.commits.get(self.refs.get(ref, ""), {}) | files
        sha = hashlib.sha1(repr((sorted(whole.items()), len(self.commits))).encode()).hexdigest()
        self.commits[sha], self.refs[ref] = whole, sha
        return sha


class HubError(Exception):
    """An answer of the hub that is an error."""

    def __init__(self, status: int, code: str = "", **data: str):
        super().__init__(status, code)
        self.status, self.code, self.data = status, code, data


class Hub:
    """The contents of the stand-in, what it was asked, and what it does wrong if a test wants it."""

    def __init__(self):
        self.repositories: dict[str, Repository] = {}
        self.uploads: dict[str, bytes] = {}
        self.asked: list[str] = []
        self.cut_after: dict[str, int] = {}
        """Files of which only so many bytes are sent before the connection ends."""
        self.url, self.cache = "", Path()

    def settings(self, home: Path) -> dict[str, str]:
        """Returns the environment variables that connect the client of another process, which has the token."""
        settings = {"HF_ENDPOINT": self.url, "HF_HOME": f"{home}", "HF_HUB_OFFLINE": "0"}
        return settings | {"HF_TOKEN": TOKEN, "HF_HUB_DISABLE_XET": "1"}

    def add(self, name: str, folder: Path, *, ref: str = "main", private: bool = False) -> str:
        """Puts the files of a folder into a repository, and returns the commit."""
        repository = self.repositories.setdefault(name, Repository(private=private))
        files = [path for path in folder.rglob("*") if path.is_file()]
        return repository.commit({path.relative_to(folder).as_posix(): path.read_bytes() for path in files}, ref=ref)

    def files(self, name: str, ref: str = "main") -> dict[str, bytes]:
        """Returns the newest files of a branch."""
        repository = self.repositories[name]
        return repository.commits[repository.refs[ref]]

    def downloaded(self) -> set[str]:
        """Returns the names of the files whose contents were asked for."""
        return {found[1] for line in self.asked if (found := re.match(r"GET .*/resolve/\w+/(.*)", line))}

    def find(self, name: str, revision: str, token: str | None) -> tuple[Repository, str]:
        """Returns a repository and the commit of a revision."""
        repository = self.repositories.get(name)
        if repository is None or (repository.private and token != f"Bearer {TOKEN}"):
            raise HubError(401 if token is None else 404, "RepoNotFound")
        commit = repository.refs.get(revision, revision)
        if commit not in repository.commits:
            raise HubError(404, "RevisionNotFound")
        return repository, commit

    def get(self, path: str, token: str | None):
        """Returns the answer to GET: data, or the commit and the contents of a file."""
        if found := re.fullmatch(r"/api/models/([^/]+/[^/]+)(?:/(revision|tree)/([^/]+))?", path):
            repository, commit = self.find(found[1], unquote(found[3] or "main"), token)
            sizes = {name: len(data) for name, data in repository.commits[commit].items()}
            if found[2] == "tree":
                return [{"type": "file", "path": name, "size": sizes[name], "oid": name} for name in sizes]
            siblings = [{"rfilename": name, "size": size} for name, size in sizes.items()]
            return {"id": found[1], "sha": commit, "private": repository.private, "siblings": siblings}
        if found := re.fullmatch(r"/([^/]+/[^/]+)/resolve/([^/]+)/(.+)", path):
            repository, commit = self.find(found[1], unquote(found[2]), token)
            if unquote(found[3]) not in repository.commits[commit]:
                raise HubError(404, "EntryNotFound")
            return commit, repository.commits[commit][unquote(found[3])]
        raise HubError(404)

    def post(self, path: str, body: bytes, token: str | None):
        """Returns the answer to POST and PUT, which need the token."""
        if path.startswith("/upload/"):
            self.uploads[path.removeprefix("/upload/")] = body
            return {}
        if token != f"Bearer {TOKEN}":
            raise HubError(401)
        lines = [json.loads(line) for line in body.splitlines()]
        if path == "/api/repos/create":
            name = f"{lines[0]['organization']}/{lines[0]['name']}"
            is_private = lines[0].get("private") or lines[0].get("visibility") == "private"
            if name in self.repositories:
                raise HubError(409, url=f"{self.url}/{name}")
            self.repositories[name] = Repository(private=bool(is_private))
            return {"url": f"{self.url}/{name}"}
        if path == "/api/validate-yaml":
            return {}
        if path.endswith(".git/info/lfs/objects/batch"):
            objects = [
                entry | {"actions": {"upload": {"href": f"{self.url}/upload/{entry['oid']}"}}}
                for entry in lines[0]["objects"]
            ]
            return {"transfer": "basic", "objects": objects}
        found = re.fullmatch(r"/api/models/([^/]+/[^/]+)/(branch|preupload|commit)/([^/]+)", path)
        if not found:
            raise HubError(404)
        return self.change(found[1], found[2], unquote(found[3]), lines, token)

    def change(self, name: str, task: str, ref: str, lines: list, token: str | None):
        """Returns the answer to a step of an upload, and makes the branch or the commit."""
        repository, commit = self.find(name, "main" if task == "branch" else ref, token)
        if task == "branch":
            if ref in repository.refs:
                raise HubError(409)
            repository.refs[ref] = commit
            return {}
        if task == "preupload":
            modes = {True: "lfs", False: "regular"}
            files = [(file["path"], modes[file["path"].endswith(".safetensors")]) for file in lines[0]["files"]]
            return {"files": [{"path": path, "uploadMode": mode, "shouldIgnore": False} for path, mode in files]}
        operations = [(line["key"], line["value"]) for line in lines]
        files = {value["path"]: base64.b64decode(value["content"]) for key, value in operations if key == "file"}
        files |= {value["path"]: self.uploads[value["oid"]] for key, value in operations if key == "lfsFile"}
        sha = repository.commit(files, ref=ref)
        return {"commitUrl": f"{self.url}/{name}/commit/{sha}", "commitOid": sha}


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    hub: Hub

    def do_GET(self):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        path, token = urlsplit(self.path).path, self.headers.get("Authorization")
        self.hub.asked.append(f"{self.command} {path}")
        try:
            if len(self.hub.asked) > MAX_REQUESTS:
                raise HubError(500)
            is_read = self.command in ("GET", "HEAD")
            answer = self.hub.get(path, token) if is_read else self.hub.post(path, body, token)
        except HubError as error:
            return self.answer(error.status, json.dumps(error.data).encode(), {"X-Error-Code": error.code})
        if not isinstance(answer, tuple):
            return self.answer(200, json.dumps(answer).encode(), {"Content-Type": "application/json"})
        commit, content = answer
        etag = f'"{hashlib.sha1(content).hexdigest()}"'
        return self.answer(200, content, {"X-Repo-Commit": commit, "ETag": etag})

    do_HEAD = do_POST = do_PUT = do_GET  # noqa: N815 - the names are the server's

    def answer(self, status: int, content: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command == "HEAD":
            return
        most = self.hub.cut_after.get(self.path.rpartition("/")[2])
        self.wfile.write(content[:most])
        self.close_connection = most is not None

    def log_message(self, *arguments):
        pass


@contextlib.contextmanager
def running_hub(monkeypatch, folder: Path):
    """Yields a stand-in to which the client of this process is connected; its copies are in `folder`."""
    from huggingface_hub import close_session, constants

    hub = Hub()
    handler = type("Handler", (_Handler,), {"hub": hub})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        hub.url, hub.cache = f"http://127.0.0.1:{server.server_port}", folder / "hub"
        settings = {"ENDPOINT": hub.url, "HF_HUB_CACHE": f"{hub.cache}", "HF_TOKEN_PATH": f"{folder / 'token'}"}
        settings |= {"HF_HUB_OFFLINE": False, "HF_HUB_DISABLE_XET": True}
        settings["HUGGINGFACE_CO_URL_TEMPLATE"] = hub.url + "/{repo_id}/resolve/{revision}/{filename}"
        settings["AGENT_HARNESSES_PATH"] = f"{folder / 'harnesses.json'}"
        for name, value in settings.items():
            monkeypatch.setattr(constants, name, value, raising=False)
        monkeypatch.delenv("HF_TOKEN", raising=False)
        close_session()
        try:
            yield hub
        finally:
            close_session()
            server.shutdown()
            thread.join()
