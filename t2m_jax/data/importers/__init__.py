"""Importers: functions that make a data-set folder from other files."""
