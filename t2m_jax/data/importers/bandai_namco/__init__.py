"""The Bandai-Namco Research motion data set: its importer, its captions and their wordings."""

from t2m_jax.data.importers.bandai_namco.captions import write_captions
from t2m_jax.data.importers.bandai_namco.importer import import_bandai_namco
from t2m_jax.data.importers.bandai_namco.measure import Facts, measure
from t2m_jax.data.importers.bandai_namco.wordings import held_out_sentences

__all__ = ["Facts", "held_out_sentences", "import_bandai_namco", "measure", "write_captions"]
