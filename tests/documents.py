"""The pages of the documentation and the code in them, for the tests of pages."""

import re
from pathlib import Path

from tests.conftest import REPOSITORY

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs" / "howto").glob("*.md"))]
PAGES += sorted(path for path in (REPOSITORY / "docs").glob("*.md") if path.name != "navigation.md")


def name_of(page: Path) -> str:
    """Returns the path of a page in the repository."""
    return page.relative_to(REPOSITORY).as_posix()


def code_blocks(page: Path, languages: str) -> list[tuple[str, str]]:
    """Returns language and text of each block of code in the languages of a pattern, such as `sh|python`."""
    return re.findall(rf"```({languages})\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def commands(text: str) -> list[str]:
    """Returns the lines of shell code that run `t2m`, without comments. Values of variables replace their names."""
    lines = [line.partition("  #")[0].strip() for line in text.replace("\\\n", " ").splitlines()]
    for name, value in re.findall(r'^(\w+)="(.*)"$', text, re.MULTILINE):
        lines = [line.replace(f"${name}", value) for line in lines]
    return [line for line in lines if re.search(r"(^|\s)t2m ", line) and not line.startswith("#")]
