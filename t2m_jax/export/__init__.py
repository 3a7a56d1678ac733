"""Motion files: archives, BVH, pictures, videos and the viewer."""

from t2m_jax.export.bvh import save_bvh_file
from t2m_jax.export.formats import load_motion
from t2m_jax.export.gif import save_gif
from t2m_jax.export.glb import save_glb
from t2m_jax.export.html import save_html, scene_record, viewer_html
from t2m_jax.export.mp4 import save_mp4
from t2m_jax.export.npz import load_npz, save_npz
from t2m_jax.export.pieces import save_pieces
from t2m_jax.export.png import save_png
from t2m_jax.export.render import render_poster

__all__ = [
    "load_motion",
    "load_npz",
    "render_poster",
    "save_bvh_file",
    "save_gif",
    "save_glb",
    "save_html",
    "save_mp4",
    "save_npz",
    "save_pieces",
    "save_png",
    "scene_record",
    "viewer_html",
]
