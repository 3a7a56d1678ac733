"""The Bandai-Namco Research motion data set: its importer, and clips that are composed of its clips."""
