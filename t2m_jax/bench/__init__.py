"""Benchmarks: how fast a machine trains, samples, evaluates and reads data."""

from t2m_jax.bench.record import load_report, save_report
from t2m_jax.bench.sample import benchmark_sampling
from t2m_jax.bench.tables import report_text
from t2m_jax.bench.train import benchmark_training

__all__ = ["benchmark_sampling", "benchmark_training", "load_report", "report_text", "save_report"]
