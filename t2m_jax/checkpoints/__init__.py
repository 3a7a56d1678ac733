"""Trained weights on disk: run directories, bundles, official files."""
