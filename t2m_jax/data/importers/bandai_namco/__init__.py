"""The importer of the Bandai-Namco Research motion data set."""
