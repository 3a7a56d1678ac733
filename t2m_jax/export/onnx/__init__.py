"""Models as ONNX graphs, for engines and runtimes without Python; the extra `onnx` installs what this needs."""
