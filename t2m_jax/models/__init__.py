"""The networks, as Linen modules with frozen configs; a module has one field, `config`."""

from t2m_jax.models.caption_encoder import CaptionEncoder, CaptionEncoderConfig
from t2m_jax.models.clip_text import ClipText, ClipTextConfig
from t2m_jax.models.evaluator import Evaluator, EvaluatorConfig
from t2m_jax.models.hifigpt import HiFiGpt, HiFiGptConfig
from t2m_jax.models.motion_gpt import MotionGpt, MotionGptConfig
from t2m_jax.models.sentence_encoder import SentenceEncoder, SentenceEncoderConfig
from t2m_jax.models.system import Generator, GeneratorConfig, Part, Tokenizer, TokenizerConfig, find_part, make_module
from t2m_jax.models.vqvae import RvqVaeConfig, VqVae, VqVaeConfig

__all__ = [
    "CaptionEncoder",
    "CaptionEncoderConfig",
    "ClipText",
    "ClipTextConfig",
    "Evaluator",
    "EvaluatorConfig",
    "Generator",
    "GeneratorConfig",
    "HiFiGpt",
    "HiFiGptConfig",
    "MotionGpt",
    "MotionGptConfig",
    "Part",
    "RvqVaeConfig",
    "SentenceEncoder",
    "SentenceEncoderConfig",
    "Tokenizer",
    "TokenizerConfig",
    "VqVae",
    "VqVaeConfig",
    "find_part",
    "make_module",
]
