"""Pages from templates of the package."""

import importlib.resources
import re
from collections.abc import Mapping


def fill_template(package: str, name: str, parts: Mapping[str, str]) -> str:
    """Returns a file of a package, in which each mark such as `{{title}}` is replaced by the part of its name."""
    template = (importlib.resources.files(package) / name).read_text(encoding="utf-8")
    # All marks at once, so that text like a mark inside a part, such as a caption, is not replaced.
    return re.sub(r"\{\{(\w+)\}\}", lambda mark: parts[mark[1]], template)
