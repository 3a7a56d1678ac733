"""From text to motion."""

from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.strategies import Greedy, Strategy, Temperature, TopK, TopP, make_strategy

__all__ = ["Greedy", "Strategy", "Temperature", "TextToMotion", "TopK", "TopP", "make_strategy"]
