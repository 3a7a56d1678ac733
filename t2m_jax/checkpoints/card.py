"""The model card a bundle gets when its maker wrote none."""

from pathlib import Path

from t2m_jax.checkpoints.run import CONFIG_FILE


def plain_card(run: Path) -> str:
    """Returns Markdown with the config a run was trained with and what the maker should add."""
    config = (run / CONFIG_FILE).read_text(encoding="utf-8").strip()
    return (
        f"# {run.name}\n\n"
        "A text-to-motion model trained with t2m_jax. Its makers have not said on which data, under which licence, or\n"
        "how good it is: ask them before you use or pass it on.\n\n"
        f"## Training config\n\n```yaml\n{config}\n```\n"
    )
