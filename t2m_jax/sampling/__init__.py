"""From text to motion."""

from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.programs import encode_motions
from t2m_jax.sampling.request import MotionRequest, SamplingOptions
from t2m_jax.sampling.stopping import StopAtEnd, StopAtHighest, StopAtRandom, StopAtThreshold
from t2m_jax.sampling.strategies import Greedy, Temperature, TopK, TopP

__all__ = [
    "Greedy",
    "MotionRequest",
    "SamplingOptions",
    "StopAtEnd",
    "StopAtHighest",
    "StopAtRandom",
    "StopAtThreshold",
    "Temperature",
    "TextToMotion",
    "TopK",
    "TopP",
    "encode_motions",
]
