"""Text to human motion in JAX: `t2m_jax.load("demo").generate("a person walks")`.

Names are imported when they are used, so that `import t2m_jax` and `t2m --help` stay quick.
"""

TYPE_CHECKING = False  # type checkers know this name; importing it would take as long as the rest

if TYPE_CHECKING:
    from pathlib import Path

    from t2m_jax.motion.motion import Motion as Motion
    from t2m_jax.sampling.pipeline import TextToMotion

__all__ = ["Motion", "__version__", "load"]

__version__: str


def load(name_or_path: "str | Path") -> "TextToMotion":
    """Returns a model by the name of a packaged one (`demo`), or from the folder of a bundle or of a generator's run.

    A text such as `user/name` that is not a folder is a model on the Hugging Face hub, which is downloaded once.
    `user/name@revision` is a branch, a tag or a commit of it.

    Raises:
        UserError: There is no such model, it is damaged, or it has no license.
    """
    from t2m_jax.sampling.pipeline import TextToMotion

    return TextToMotion.load(name_or_path)


def __getattr__(name: str) -> object:
    if name == "Motion":
        from t2m_jax.motion.motion import Motion

        return Motion
    if name == "__version__":
        from importlib.metadata import version

        return version("t2m-jax")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
