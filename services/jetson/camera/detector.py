"""Picture -> boxes, with any ONNX network in the YOLOv8 output layout.

Layout: one input (1, 3, H, W) RGB in 0..1; one output (1, 4 + classes, N) whose columns are candidates: centre x,
centre y, width, height in input pixels, then one score in 0..1 per class. No non-maximum suppression inside.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors

from common.config import ConfigError
from services.jetson.camera.config import DetectorConfig
from services.jetson.camera.letterbox import Fit, letterbox, undo

DEMO_MODEL = Path(__file__).with_name("models") / "demo.onnx"
EXPECTED = "one input (1, 3, H, W) and one output (1, 4 + classes, N), the layout of a YOLOv8 export without NMS"
_LOAD_ERRORS = (
    ort_errors.Fail,
    ort_errors.InvalidArgument,
    ort_errors.InvalidGraph,
    ort_errors.InvalidProtobuf,
    ort_errors.NoModel,
    ort_errors.NotImplemented,
    ort_errors.RuntimeException,
)
_DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


class ModelError(ConfigError):
    """The model file is not what this service can run; the text says what was expected and what was found."""


class Boxes(NamedTuple):
    """Detections of one picture, most confident first."""

    xyxy_px: np.ndarray  # (N, 4) float32, picture pixels
    confidence: np.ndarray  # (N,) float32
    class_id: np.ndarray  # (N,) int


class Detector:
    """Loads and warms up the network once; ``detect`` is then called per picture."""

    def __init__(self, config: DetectorConfig) -> None:
        cv2.setNumThreads(1)
        self._config = config
        self.path = Path(config.model).expanduser() if config.model else DEMO_MODEL
        self._session = _open(self.path, config)
        self._input, self.names = _check(self._session, self.path)
        self._dtype = _DTYPES[self._input.type]
        self.height_px, self.width_px = (
            size if isinstance(size, int) else config.dynamic_input_px for size in self._input.shape[2:]
        )
        self._wanted = _wanted_classes(config.classes, self.names, self.path)
        self._warm_up()

    @property
    def provider(self) -> str:
        """What the network runs on, for example "CPUExecutionProvider"."""
        return str(self._session.get_providers()[0])

    def detect(self, image: np.ndarray) -> Boxes:
        """All three steps for one picture (H, W, 3) uint8 BGR."""
        blob, fit = self.preprocess(image)
        return self.postprocess(self.infer(blob), fit, image.shape)

    def preprocess(self, image: np.ndarray) -> tuple[np.ndarray, Fit]:
        """(H, W, 3) uint8 BGR to the network's input and the fit needed to map boxes back."""
        return letterbox(image, self.width_px, self.height_px)

    def infer(self, blob: np.ndarray) -> np.ndarray:
        """Network input to its raw output (4 + classes, N)."""
        outputs = self._session.run(None, {self._input.name: blob.astype(self._dtype, copy=False)})
        return np.asarray(outputs[0][0])

    def postprocess(self, output: np.ndarray, fit: Fit, shape: tuple[int, ...]) -> Boxes:
        """Raw output to boxes in picture pixels."""
        boxes = decode(output, self._config.confidence, self._wanted)
        boxes = suppress(boxes, self._config.confidence, self._config.iou)
        return boxes._replace(xyxy_px=undo(boxes.xyxy_px, fit, shape[1], shape[0]))

    def _warm_up(self) -> None:
        """The first run compiles kernels and allocates; it also proves the output's shape."""
        blob, _ = self.preprocess(np.zeros((self.height_px, self.width_px, 3), np.uint8))
        shape = self.infer(blob).shape
        if len(shape) != 2 or shape[0] != 4 + len(self.names):
            found = f"an output of shape (1, {', '.join(map(str, shape))}) with {len(self.names)} names"
            raise ModelError(f"{self.path}: expected {EXPECTED}; found {found}")


def decode(output: np.ndarray, confidence: float, wanted: np.ndarray | None = None) -> Boxes:
    """(4 + classes, N) network output to the candidates above the confidence, as corner boxes in input pixels.

    Candidates with a value that is not finite, or with no area, are dropped. ``wanted`` (classes,) bool hides classes.
    """
    scores = output[4:]
    if wanted is not None:
        scores = scores[wanted]
    kept = np.flatnonzero(scores.max(axis=0) >= confidence)
    centre, size = output[:2, kept].astype(np.float32), output[2:4, kept].astype(np.float32)
    scores = scores[:, kept].astype(np.float32)
    good = np.isfinite(centre).all(0) & np.isfinite(size).all(0) & np.isfinite(scores).all(0) & (size > 0).all(0)
    centre, size, scores = centre[:, good], size[:, good], scores[:, good]
    class_id = scores.argmax(axis=0)
    best = np.clip(scores.max(axis=0, initial=0.0), 0.0, 1.0)
    if wanted is not None:
        class_id = np.flatnonzero(wanted)[class_id]
    return Boxes(np.concatenate([centre - size / 2, centre + size / 2]).T, best, class_id)


def suppress(boxes: Boxes, confidence: float, iou: float) -> Boxes:
    """Non-maximum suppression per class: of boxes of one class that overlap more than ``iou``, the surest stays."""
    if not len(boxes.confidence):
        return boxes
    xywh = np.concatenate([boxes.xyxy_px[:, :2], boxes.xyxy_px[:, 2:] - boxes.xyxy_px[:, :2]], axis=1)
    survivors = cv2.dnn.NMSBoxesBatched(
        xywh.astype(float).tolist(), boxes.confidence.tolist(), boxes.class_id.tolist(), confidence, iou
    )
    kept = np.asarray(survivors, dtype=int).reshape(-1)
    kept = kept[np.argsort(-boxes.confidence[kept], kind="stable")]
    return Boxes(boxes.xyxy_px[kept], boxes.confidence[kept], boxes.class_id[kept])


def _open(path: Path, config: DetectorConfig) -> onnxruntime.InferenceSession:
    if not path.is_file():
        raise ModelError(f"[detector] model = {str(path)!r}: no such file; expected an ONNX file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = config.threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # leave the cores to the other services
    providers = choose_providers(config, onnxruntime.get_available_providers())
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=providers)
    except _LOAD_ERRORS as error:
        first_line = str(error).splitlines()[0]
        raise ModelError(f"{path}: expected an ONNX network; found a file that does not load: {first_line}") from None


def choose_providers(config: DetectorConfig, available: list[str]) -> list[tuple[str, dict[str, object]]]:
    """What onnxruntime shall try, in the order of the configuration, with options; the CPU if nothing else is there."""
    cache = {"trt_engine_cache_enable": True, "trt_engine_cache_path": str(Path(config.tensorrt_cache).expanduser())}
    options = {"TensorrtExecutionProvider": cache if config.tensorrt_cache else {}}
    chosen = [name for name in config.providers if name in available] or ["CPUExecutionProvider"]
    return [(name, options.get(name, {})) for name in chosen]


def _check(session: onnxruntime.InferenceSession, path: Path) -> tuple[onnxruntime.NodeArg, list[str]]:
    """The input and the class names, or a refusal that says what was expected and what was found."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    found = "; ".join(
        f"{kind} {node.name} {tuple(node.shape)} {node.type}"
        for kind, nodes in (("input", inputs), ("output", outputs))
        for node in nodes
    )
    fits = (
        len(inputs) == len(outputs) == 1
        and len(inputs[0].shape) == 4
        and inputs[0].shape[1] == 3
        and inputs[0].shape[0] in (1, None, "batch")
        and inputs[0].type in _DTYPES
        and len(outputs[0].shape) == 3
    )
    if not fits:
        raise ModelError(f"{path}: expected {EXPECTED}; found {found}")
    rows = outputs[0].shape[1]
    names = _names(session.get_modelmeta().custom_metadata_map.get("names"), rows)
    if isinstance(rows, int) and rows != 4 + len(names):
        raise ModelError(f"{path}: expected 4 + {len(names)} output rows for the names it carries; found {found}")
    return inputs[0], names


def _names(text: str | None, rows: object) -> list[str]:
    """Class names from the metadata, a literal such as ``{0: 'person', 1: 'car'}``; without it "class 0", ..."""
    if text is None:
        return [f"class {i}" for i in range(rows - 4)] if isinstance(rows, int) else []
    try:
        names = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        raise ModelError(f"expected class names such as {{0: 'person'}} in the metadata; found {text[:80]!r}") from None
    return [str(names[i]) for i in sorted(names)] if isinstance(names, dict) else [str(name) for name in names]


def _wanted_classes(classes: tuple[str, ...], names: list[str], path: Path) -> np.ndarray | None:
    if not classes:
        return None
    unknown = sorted(set(classes) - set(names))
    if unknown:
        raise ModelError(f"[detector] classes {unknown}: {path.name} knows {', '.join(names)}")
    return np.array([name in classes for name in names])
