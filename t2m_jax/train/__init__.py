"""Training: pure steps, one loop, run directories."""
