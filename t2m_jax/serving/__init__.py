"""The studio: a page and an HTTP interface, with one process that generates for all users."""

from t2m_jax.serving.app import make_app

__all__ = ["make_app"]
