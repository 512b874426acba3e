import common  # noqa: F401  (first of all: it settles what ONNX Runtime may do)
