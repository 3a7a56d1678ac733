"""Training data on the device, and the batches that are cut from it."""
