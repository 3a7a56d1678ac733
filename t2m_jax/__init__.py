"""Text to human motion in JAX. Nothing is imported here, so that `t2m --help` stays quick."""
