"""Evaluation reports: records and their files, tables, comparisons and pages."""

from t2m_jax.evaluation.report.comparison import compare_reports, comparison_table
from t2m_jax.evaluation.report.formats import format_table
from t2m_jax.evaluation.report.page import save_page
from t2m_jax.evaluation.report.record import Report, load_report, save_report
from t2m_jax.evaluation.report.tables import make_table

__all__ = [
    "Report",
    "compare_reports",
    "comparison_table",
    "format_table",
    "load_report",
    "make_table",
    "save_page",
    "save_report",
]
