"""What every host has: topics, messages, codec, config, runtime, geometry, the command line and the simulator."""

import os

# Nothing leaves a host unasked: newer versions of ONNX Runtime report home unless they find this when imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
