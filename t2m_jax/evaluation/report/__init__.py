"""Evaluation reports: records and their files, tables, comparisons and pages."""

from t2m_jax.evaluation.report.comparison import Difference, compare_reports, comparison_table
from t2m_jax.evaluation.report.details import RepeatDetails, gather_details
from t2m_jax.evaluation.report.formats import format_table
from t2m_jax.evaluation.report.page import check_page, report_page, save_page
from t2m_jax.evaluation.report.prompts import (
    PromptCounts,
    PromptReport,
    load_prompt_report,
    save_prompt_report,
)
from t2m_jax.evaluation.report.record import (
    Header,
    Metric,
    ReconstructionFigures,
    Report,
    load_reconstruction,
    load_report,
    save_report,
)
from t2m_jax.evaluation.report.tables import Table, make_table

__all__ = [
    "Difference",
    "Header",
    "Metric",
    "PromptCounts",
    "PromptReport",
    "ReconstructionFigures",
    "RepeatDetails",
    "Report",
    "Table",
    "check_page",
    "compare_reports",
    "comparison_table",
    "format_table",
    "gather_details",
    "load_prompt_report",
    "load_reconstruction",
    "load_report",
    "make_table",
    "report_page",
    "save_page",
    "save_prompt_report",
    "save_report",
]
