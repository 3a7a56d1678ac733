"""The Bandai-Namco Research motion data set: its importer, and clips that are composed of its clips."""

from t2m_jax.data.importers.bandai_namco.importer import import_bandai_namco

__all__ = ["import_bandai_namco"]
