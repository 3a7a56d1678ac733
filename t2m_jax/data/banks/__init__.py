"""Training data on the device or on the host, and the batches that are drawn from it."""
