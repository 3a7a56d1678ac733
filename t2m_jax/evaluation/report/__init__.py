"""Evaluation reports: records, tables, comparisons and pages."""
