"""A third text-to-motion system: a codebook lookup (tokenizer) and a bigram prior (generator)."""
