"""Drawing motions as pictures."""

from t2m_jax.export.render.rendering import Film, render_film, render_poster

__all__ = ["Film", "render_film", "render_poster"]
