"""The Bandai-Namco Research motion data set: its importer, its captions and their wordings."""
