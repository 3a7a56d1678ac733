"""From text to motion."""

from t2m_jax.sampling.compilation import use_compilation_cache
from t2m_jax.sampling.loop import SampledCodes, Sampling, sample_codes
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.sampling.programs import encode_motions
from t2m_jax.sampling.prompts import sample_key
from t2m_jax.sampling.stopping import (
    StopAtEnd,
    StopAtHighest,
    StopAtRandom,
    StopAtThreshold,
    StopRule,
    make_stop_rule,
)
from t2m_jax.sampling.strategies import Greedy, Strategy, Temperature, TopK, TopP, make_strategy
from t2m_jax.sampling.text_encoders import CaptionTextEncoder, PretrainedTextEncoder, make_text_encoder

__all__ = [
    "CaptionTextEncoder",
    "Greedy",
    "PretrainedTextEncoder",
    "SampledCodes",
    "Sampling",
    "StopAtEnd",
    "StopAtHighest",
    "StopAtRandom",
    "StopAtThreshold",
    "StopRule",
    "Strategy",
    "Temperature",
    "TextToMotion",
    "TopK",
    "TopP",
    "encode_motions",
    "make_stop_rule",
    "make_strategy",
    "make_text_encoder",
    "sample_codes",
    "sample_key",
    "use_compilation_cache",
]
