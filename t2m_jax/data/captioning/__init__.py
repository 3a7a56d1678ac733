"""Captions from facts: a grammar, wordings of actions and styles, and a lexicon of their words."""
