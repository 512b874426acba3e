"""What every host has: topics, messages, codec, configuration, bus, host, security, recording."""

import os

# Nothing leaves a host unasked: newer versions of ONNX Runtime report home unless they find this when imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
