"""Whether a model does what sentences ask for: groups of sentences, and rules that judge the motion."""
