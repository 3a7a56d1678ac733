"""Motion files: archives, BVH, pictures, videos and the viewer."""

from t2m_jax.export.html import viewer_html
from t2m_jax.export.npz import save_pieces
from t2m_jax.export.render.rendering import render_poster

__all__ = ["render_poster", "save_pieces", "viewer_html"]
