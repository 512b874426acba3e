"""Picture -> boxes, with any ONNX network in a layout of ``network.py``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
import numpy as np
import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors

from services.jetson.camera.config import DetectorConfig
from services.jetson.camera.letterbox import Fit, letterbox, undo
from services.jetson.camera.network import (
    EXPECTED,
    EXPORT,
    Head,
    ModelError,
    as_candidates,
    believed_head,
    class_names,
)
from services.jetson.camera.providers import choose_providers

DEMO_MODEL = Path(__file__).with_name("models") / "demo.onnx"
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


class Boxes(NamedTuple):
    """Detections of one picture, most confident first."""

    xyxy_px: np.ndarray  # (N, 4) float32, picture pixels
    confidence: np.ndarray  # (N,) float32
    class_id: np.ndarray  # (N,) int


class BoxFinder(Protocol):
    """What the pipeline asks of a detector, one step after the other."""

    @property
    def names(self) -> Sequence[str]:
        """Of the classes, by ``class_id``."""

    @property
    def provider(self) -> str:
        """What it runs on."""

    def preprocess(self, image: np.ndarray) -> tuple[np.ndarray, Fit]:
        """(H, W, 3) uint8 BGR to the input and the fit needed to map boxes back."""

    def infer(self, blob: np.ndarray) -> np.ndarray:
        """Input to raw output."""

    def postprocess(self, output: np.ndarray, fit: Fit, shape: tuple[int, ...]) -> Boxes:
        """Raw output to boxes in picture pixels."""


class Detector:
    """Loads the network, proves on test pictures that its output is what it seems; ``detect`` is called per picture.

    Raises:
        ModelError: no file, no network, or one that is not understood; says what was expected and found.
    """

    def __init__(self, config: DetectorConfig) -> None:
        cv2.setNumThreads(1)
        self._config = config
        self.path = Path(config.model).expanduser() if config.model else DEMO_MODEL
        self._session = _open(self.path, config)
        self._input = _check_input(self._session, self.path)
        self._dtype = _DTYPES[self._input.type]
        self.height_px, self.width_px = (
            size if isinstance(size, int) else config.dynamic_input_px for size in self._input.shape[2:]
        )
        self._head, self.names = self._prove()
        self._wanted = _wanted_classes(config.classes, self.names, self.path)

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
        """Network input to its raw output (A, B)."""
        return np.asarray(self._run(blob)[0])

    def postprocess(self, output: np.ndarray, fit: Fit, shape: tuple[int, ...]) -> Boxes:
        """Raw output to boxes in picture pixels."""
        if self._head.layout == "end_to_end":
            wanted = np.ones(len(self.names), bool) if self._wanted is None else self._wanted
            boxes = decode_end_to_end(output, self._config.confidence, wanted)
        else:
            boxes = decode(as_candidates(output, self._head), self._config.confidence, self._wanted)
            boxes = suppress(boxes, self._config.confidence, self._config.iou)
        named = boxes.class_id < len(self.names)
        boxes = Boxes(boxes.xyxy_px[named], boxes.confidence[named], boxes.class_id[named])
        return boxes._replace(xyxy_px=undo(boxes.xyxy_px, fit, shape[1], shape[0]))

    def _prove(self) -> tuple[Head, list[str]]:
        """The layout and the class names, from the output for two test pictures. It warms the network up as well."""
        rng = np.random.default_rng(1)
        noise = rng.integers(0, 256, (self.height_px, self.width_px, 3), np.uint8)
        try:
            outputs = [self._run(self.preprocess(picture)[0]) for picture in (np.full_like(noise, 114), noise)]
            head = believed_head(outputs, self.height_px, self.width_px)
            names = class_names(self._session.get_modelmeta().custom_metadata_map.get("names"), head)
        except ModelError as error:
            raise ModelError(
                f"{self.path}: expected {EXPECTED}; found {error}. An export that fits: {EXPORT}"
            ) from None
        except _LOAD_ERRORS as error:
            first_line = str(error).splitlines()[0]
            raise ModelError(f"{self.path}: the network fails on a test picture: {first_line}") from None
        return head, names

    def _run(self, blob: np.ndarray) -> np.ndarray:
        outputs = self._session.run(None, {self._input.name: blob.astype(self._dtype, copy=False)})
        return np.asarray(outputs[0])


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


def decode_end_to_end(rows: np.ndarray, confidence: float, wanted: np.ndarray) -> Boxes:
    """(K, 6) rows x1, y1, x2, y2, score, class to the boxes above the confidence, the surest first.

    Boxes with a value that is not finite, or with no area, are dropped. ``wanted`` (classes,) bool hides classes; the
    last class stands for all further numbers.
    """
    rows = rows[np.isfinite(rows).all(axis=1)].astype(np.float32)
    class_id = np.clip(rows[:, 5], 0, len(wanted) - 1).astype(int)
    kept = (rows[:, 4] >= confidence) & (rows[:, 2:4] > rows[:, :2]).all(axis=1) & wanted[class_id]
    order = np.flatnonzero(kept)[np.argsort(-rows[kept, 4], kind="stable")]
    return Boxes(rows[order, :4], np.minimum(rows[order, 4], 1.0), class_id[order])


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
        raise ModelError(
            f"{path}: expected an ONNX network; found a file that does not load: {first_line}. To make one: {EXPORT}"
        ) from None


def _check_input(session: onnxruntime.InferenceSession, path: Path) -> onnxruntime.NodeArg:
    """The input, or a refusal that says what was expected and what was found. Axes of any name are free sizes."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    task = session.get_modelmeta().custom_metadata_map.get("task", "detect")
    found = "; ".join(
        f"{kind} {node.name} {tuple(node.shape)} {node.type}"
        for kind, nodes in (("input", inputs), ("output", outputs))
        for node in nodes
    )
    fits = (
        len(inputs) == len(outputs) == 1
        and len(inputs[0].shape) == 4
        and inputs[0].shape[1] == 3
        and (inputs[0].shape[0] == 1 or not isinstance(inputs[0].shape[0], int))
        and inputs[0].type in _DTYPES
        and task == "detect"
    )
    if not fits:
        task_text = "" if task == "detect" else f" for the task {task!r}"
        raise ModelError(
            f"{path}: expected {EXPECTED}, for detection; found a network{task_text} with {found}. "
            f"An export that fits: {EXPORT}"
        )
    return inputs[0]


def _wanted_classes(classes: tuple[str, ...], names: list[str], path: Path) -> np.ndarray | None:
    if not classes:
        return None
    asked = {name.casefold() for name in classes}
    unknown = sorted(asked - {name.casefold() for name in names})
    if unknown:
        raise ModelError(f"[detector] classes {unknown}: {path.name} knows {', '.join(names[:100])}")
    return np.array([name.casefold() in asked for name in names])
