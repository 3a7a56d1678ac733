"""Settings of the documentation, which `make docs` builds.

The sources are the Markdown files of the repository in their own folders, so that a relative link leads to the same
file in the site and in the repository. Files that are not pages, such as configs, become downloads.
"""

from pathlib import Path

import jax
from sphinx.application import Sphinx

jax.Array.__name__ = "Array"  # signatures would show jaxlib._jax.Array
import t2m_jax  # noqa: E402 - the annotations take the name above

project = "t2m_jax"
release = t2m_jax.__version__
html_title = f"{project} {release}"
html_theme = "furo"
html_extra_path = ["static"]
html_copy_source = False
html_show_copyright = False
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]

root_doc = "README"
include_patterns = ["*.md", "docs/**.md", "t2m_jax/bundles/*/README.md"]
exclude_patterns = [".*", "docs/navigation.md"]
myst_heading_anchors = 4

add_module_names = False
autodoc_default_options = {"members": True, "member-order": "bysource", "exclude-members": "name, parent, scope"}
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
default_role = "code"  # docstrings write code as Markdown does


def add_navigation(app: Sphinx, docname: str, source: list[str]) -> None:
    """Adds the table of contents to the README, whose readers in the repository do not need it."""
    if docname == root_doc:
        source[0] += (Path(app.confdir) / "navigation.md").read_text(encoding="utf-8")


def keep_colons(app: Sphinx, what: str, name: str, _: object, options: object, lines: list[str]) -> None:
    """Puts an empty first line before docstrings of fields. Napoleon takes what is before a colon in it for a type."""
    if lines and lines[0].startswith("Alias for field number"):  # a field of a named tuple without a docstring
        lines.clear()
    elif what in ("attribute", "property"):
        lines.insert(0, "\\ ")


def setup(app: Sphinx) -> None:
    """Connects what Sphinx has no settings for; Napoleon's own priority is 500."""
    app.connect("source-read", add_navigation)
    app.connect("autodoc-process-docstring", keep_colons, priority=499)
