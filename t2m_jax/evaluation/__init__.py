"""Protocols that turn models and data into figures."""
