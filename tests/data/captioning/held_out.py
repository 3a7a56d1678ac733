"""Writes the fingerprints of all test sentences: `python -m tests.data.captioning.held_out [FILE]...`.

Test sentences are all texts of several words in the files `held_out*.yaml` of the package. Those with `{side}` are
meant for both sides. Files of other test sentences, one on a line, may be given, so that these need not be in the
package.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

import t2m_jax
from t2m_jax.data.captioning import held_out

PACKAGE = Path(t2m_jax.__file__).parent


def find_sentences() -> set[str]:
    """Returns all test sentences."""
    tables = [yaml.safe_load(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("held_out*.yaml")]
    return {
        text.replace("{side}", side)
        for table in tables
        for text in _leaves(table)
        if " " in text
        for side in ("left", "right")
    }


def _leaves(table: Any) -> Iterator[str]:
    if isinstance(table, dict):
        table = list(table.values())
    if isinstance(table, list):
        for entry in table:
            yield from _leaves(entry)
    elif isinstance(table, str):
        yield table


if __name__ == "__main__":
    private = [line for file in sys.argv[1:] for line in Path(file).read_text(encoding="utf-8").splitlines()]
    new = {held_out.fingerprint(text) for text in (*find_sentences(), *private)}
    lines = sorted(new | held_out.held_out_fingerprints())
    (PACKAGE / "data/captioning" / held_out.FILE).write_text("".join(f"{line}\n" for line in lines), encoding="ascii")
