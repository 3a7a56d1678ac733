"""Drawing motions as pictures."""
