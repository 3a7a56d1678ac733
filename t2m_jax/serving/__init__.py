"""The studio: a page and an HTTP interface, with one process that generates for all users."""

from t2m_jax.serving.app import make_app
from t2m_jax.serving.jobs import Jobs
from t2m_jax.serving.requests import MotionRequest

__all__ = ["Jobs", "MotionRequest", "make_app"]
