"""Benchmarks: how fast a machine trains, samples and evaluates, and what that means for many accelerators."""

from t2m_jax.bench.comparison import Comparison, Regression, check_same_machine, compare_reports
from t2m_jax.bench.data import benchmark_opening, benchmark_windows
from t2m_jax.bench.evaluate import benchmark_embedding
from t2m_jax.bench.flops import count_flops
from t2m_jax.bench.probes import describe_machine, first_devices, measure_peaks
from t2m_jax.bench.record import Figure, Machine, Peaks, Report, Row, load_report, save_report
from t2m_jax.bench.run import make_report, measure_all
from t2m_jax.bench.sample import Subject, benchmark_sampling, full_size_subjects, random_variables
from t2m_jax.bench.scaling import Interconnect, Prediction, Recipe, predict, published_recipes, scaling_rows
from t2m_jax.bench.tables import fitted_table, report_text
from t2m_jax.bench.train import Options, benchmark_training, make_training, update_flops

__all__ = [
    "Comparison",
    "Figure",
    "Interconnect",
    "Machine",
    "Options",
    "Peaks",
    "Prediction",
    "Recipe",
    "Regression",
    "Report",
    "Row",
    "Subject",
    "benchmark_embedding",
    "benchmark_opening",
    "benchmark_sampling",
    "benchmark_training",
    "benchmark_windows",
    "check_same_machine",
    "compare_reports",
    "count_flops",
    "describe_machine",
    "first_devices",
    "fitted_table",
    "full_size_subjects",
    "load_report",
    "make_report",
    "make_training",
    "measure_all",
    "measure_peaks",
    "predict",
    "published_recipes",
    "random_variables",
    "report_text",
    "save_report",
    "scaling_rows",
    "update_flops",
]
