"""The folder of `t2m export page`: the graphs of a model, and a page that runs them in the browser."""

import hashlib
import importlib.resources
import json
import re
from pathlib import Path
from typing import Any

from t2m_jax.checkpoints.bundle import Bundle
from t2m_jax.errors import UserError
from t2m_jax.export.glb import save_figure
from t2m_jax.export.html import VIEWER_SCRIPTS, stage_style, viewer_script
from t2m_jax.export.onnx.folder import export_onnx, file_records
from t2m_jax.export.page.figure import figure_record
from t2m_jax.export.page.meanings import meanings_record
from t2m_jax.files.reading import load_bytes, load_json
from t2m_jax.files.template import fill_template
from t2m_jax.files.writing import atomic_folder, save_json, save_text
from t2m_jax.motion.skeleton import HUMANML3D, skeleton_from_name
from t2m_jax.text.bpe import TOKENIZER_FILE

FILES_FILE = "files.json"
"""Sizes and digests of the files that the page checks."""
STUDIO_FILES = (
    "dom.js", "memory.js", "player.js", "progress.js", "savefile.js", "session.js", "studio.css", "theme.css",
    "theme.js", "timeline.css",
)  # fmt: skip
"""What the page has in common with the studio."""
MOST_SENTENCES = 6
"""Sentences in turn of the longest motion."""
TEMPLATES = ("index.html", "sw.js")
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'"
)
"""The content security policy: nothing comes from or goes to another server, and no text becomes code."""
TOKENIZERS = {("WordPiece", "BertPreTokenizer"), ("BPE", "Whitespace")}
"""Kinds that the page can read: model, and way to split."""


def export_page(folder: Path, bundle: Bundle) -> None:
    """Writes the static files of a page that makes motions with a model; the folder appears complete or not at all.

    Raises:
        UserError: `folder` exists already, the model cannot be exported, or the page cannot read its tokenizer.
    """
    with atomic_folder(folder) as partial:
        model = partial / "model"
        export_onnx(model, bundle, sentences=MOST_SENTENCES)
        _check_tokenizer(model / TOKENIZER_FILE)
        skeleton = skeleton_from_name(bundle.config.skeleton)
        save_json(model / "figure.json", figure_record(skeleton))
        meanings = meanings_record(bundle)
        if meanings is not None:
            save_json(model / "meanings.json", meanings)
        if skeleton == HUMANML3D:
            save_figure(model / "figure.glb")
        _copy_page(partial)
        files = _checked_files(partial)
        save_json(partial / FILES_FILE, files)
        _fill_templates(partial)


def _check_tokenizer(path: Path) -> None:
    """Raises `UserError` if the page cannot read a tokenizer."""
    tree = load_json(path)
    kind = (tree["model"]["type"], (tree["pre_tokenizer"] or {}).get("type"))
    if kind not in TOKENIZERS:
        raise UserError(
            "model: its text encoder has a tokenizer that the page cannot read, such as CLIP's; "
            "give a model with MiniLM or an encoder of its own"
        )


def _copy_page(folder: Path) -> None:
    """Writes the files that are the same for all models."""
    package = importlib.resources.files("t2m_jax")
    web = package / "export" / "page" / "web"
    # Read as files: to import the package of the studio would need the extra `serve`.
    studio = package / "serving" / "page"
    pages = [(f"assets/{file.name}", file) for file in web.iterdir() if file.is_file() and file.name not in TEMPLATES]
    vendored = ("ort.min.js", "ort.wasm.packed", "LICENSE", "ThirdPartyNotices.txt")
    pages += [(f"assets/vendor/{name}", web / "vendor" / name) for name in vendored]
    pages += [(f"studio/{name}", studio / name) for name in STUDIO_FILES]
    for name, file in pages:
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_bytes(file.read_bytes())
    save_text(folder / "studio" / "stage.css", stage_style())
    save_text(folder / "studio" / "viewer.js", viewer_script(*VIEWER_SCRIPTS))


def _checked_files(folder: Path) -> dict[str, dict[str, Any]]:
    """Returns size and digest of each file that the page loads as data."""
    runtime = folder / "assets" / "vendor" / "ort.wasm.packed"
    return file_records(folder, [*sorted((folder / "model").iterdir()), runtime])


def _fill_templates(folder: Path) -> None:
    """Writes the page and its service worker, which names a digest of all other files."""
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    digest = hashlib.sha256()
    for name in names:
        digest.update(name.encode() + b"\0" + hashlib.sha256(load_bytes(folder / name)).digest())
    scripts = [name for name in names if name.startswith("studio/") or name.endswith((".js", ".css"))]
    shell = ["./", FILES_FILE, *scripts]
    parts = {"policy": POLICY, "symbols": _symbols()}
    save_text(folder / "index.html", fill_template("t2m_jax.export.page", "web/index.html", parts))
    digest.update(load_bytes(folder / "index.html"))
    parts = {"policy": POLICY, "shell": json.dumps(shell), "version": digest.hexdigest()[:16]}
    save_text(folder / "sw.js", fill_template("t2m_jax.export.page", "web/sw.js", parts))


def _symbols() -> str:
    """Returns the icons of the studio."""
    page = importlib.resources.files("t2m_jax") / "serving" / "page" / "index.html"
    return re.findall(r'<svg class="symbols".*?\n</svg>', page.read_text(encoding="utf-8"), re.DOTALL)[0]
