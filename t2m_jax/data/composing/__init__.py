"""Training motions that are made of others: in turn, at once, repeated, for a time, still, slow."""
