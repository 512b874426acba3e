"""Which layout a network's output has: told by its shape and by what it says of test pictures, never by its name.

Input (1, 3, H, W), RGB in 0..1. Outputs that are understood, N = the anchors that the strides give for H x W:

===============  ==================  ==================================================================================
``v8``           (1, 4 + C, N)       YOLOv8 to YOLO11 exports: centre x, y, width, height, a score per class
``transposed``   (1, N, 4 + C)       the same with candidates as rows
``v5``           (1, 3 N, 5 + C)     YOLOv5: centre x, y, width, height, objectness, a score per class
``end_to_end``   (1, K, 6)           suppressed inside (the default of newest exports): x1, y1, x2, y2, score, class
===============  ==================  ==================================================================================
"""

from __future__ import annotations

import ast
import json
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from common.config import ConfigError

Layout = Literal["v8", "transposed", "v5", "end_to_end"]

STRIDES = (4, 8, 16, 32, 64)
END_TO_END_ROWS = 6
MOST_END_TO_END = 2000  # rows; networks give 100 to 1000
SCORE_SLACK = 1e-2  # half precision
MOST_OUTSIDE = 0.1  # share of boxes whose centre is half a picture away from it
SMALLEST_SIDE_PX = 2.0  # networks mark no smaller thing; boxes in 0..1 would all be smaller
EXPECTED = (
    "one input (1, 3, H, W) and one output (1, 4 + classes, anchors), its transpose, (1, 3 anchors, 5 + classes), or "
    "(1, K, 6) with suppression inside"
)
EXPORT = "yolo export model=yolo11n.pt format=onnx imgsz=640"


class ModelError(ConfigError):
    """The model file is not what this service can run; the text says what was expected and what was found."""


class Head(NamedTuple):
    """How to read the output."""

    layout: Layout
    classes: int | None  # None = the output does not tell


def anchors(height_px: int, width_px: int) -> set[int]:
    """Numbers of candidates that some neighbouring strides give."""
    cells = [(-(-height_px // stride)) * (-(-width_px // stride)) for stride in STRIDES]
    return {sum(cells[first:last]) for first, last in combinations(range(len(STRIDES) + 1), 2)}


def possible_heads(shape: tuple[int, ...], height_px: int, width_px: int) -> list[Head]:
    """The layouts that an output (1, A, B) may have for an input of this size, the likeliest first.

    Raises:
        ModelError: no layout has this shape.
    """
    heads: list[Head] = []
    if len(shape) == 3 and shape[0] == 1:
        known = anchors(height_px, width_px)
        _, rows, columns = shape
        if columns in known and rows > 4:
            heads.append(Head("v8", rows - 4))
        if columns == END_TO_END_ROWS and 0 < rows <= MOST_END_TO_END:
            heads.append(Head("end_to_end", None))
        if rows in known and columns > 4:
            heads.append(Head("transposed", columns - 4))
        if rows % 3 == 0 and rows // 3 in known and columns > 5:
            heads.append(Head("v5", columns - 5))
    if not heads:
        raise ModelError(f"an output of shape {shape}, which fits no layout for an input of {height_px} x {width_px}")
    return heads


def believed_head(outputs: list[np.ndarray], height_px: int, width_px: int) -> Head:
    """The first possible layout that all outputs (1, A, B) for test pictures agree with.

    Raises:
        ModelError: there is none; says what was found.
    """
    refusal: ModelError | None = None
    for head in possible_heads(outputs[0].shape, height_px, width_px):
        try:
            for output in outputs:
                check_output(output[0].astype(np.float32), head, height_px, width_px)
        except ModelError as error:
            refusal = refusal or error
        else:
            return head
    assert refusal is not None
    raise refusal


def as_candidates(output: np.ndarray, head: Head) -> np.ndarray:
    """(4 + classes, N) rows of centre x, y, width, height and class scores from a raw output (A, B)."""
    if head.layout == "v8":
        return output
    if head.layout == "transposed":
        return output.T
    if head.layout == "v5":
        return np.concatenate([output[:, :4], output[:, 4:5] * output[:, 5:]], axis=1).T
    raise ValueError("an end-to-end output has no candidates")


def check_output(output: np.ndarray, head: Head, height_px: int, width_px: int) -> None:
    """Refuse a raw output (A, B) for a test picture that the layout cannot have.

    Raises:
        ModelError: says what was found.
    """
    if not np.isfinite(output).all():
        raise ModelError("values that are no numbers")
    if head.layout == "end_to_end":
        scores, sides = output[:, 4], output[:, 2:4] - output[:, :2]
        centres, classes = (output[:, 2:4] + output[:, :2]) / 2, output[:, 5]
        if (classes < 0).any() or (classes != np.round(classes)).any():
            raise ModelError("class numbers that are not whole in the sixth column")
        if (sides < -1.0).any():
            raise ModelError("boxes whose right or lower edge lies before the left or upper one")
    else:
        candidates = as_candidates(output, head)
        scores, sides, centres = candidates[4:], candidates[2:4].T, candidates[:2].T
    _check_scores(scores)
    if 0 < sides.max(initial=0.0) < SMALLEST_SIDE_PX:
        raise ModelError("boxes smaller than a pixel: they are expected in pixels of the input, not in 0..1")
    size = np.array([width_px, height_px], np.float32)
    outside = ((centres < -size / 2) | (centres > 1.5 * size)).any(axis=1)
    if outside.mean() > MOST_OUTSIDE:
        raise ModelError(f"{outside.mean():.0%} of the boxes far outside the picture")


def _check_scores(scores: np.ndarray) -> None:
    low, high = float(scores.min(initial=0.0)), float(scores.max(initial=0.0))
    if low < -SCORE_SLACK or high > 1.0 + SCORE_SLACK:
        raise ModelError(
            f"scores from {low:.3g} to {high:.3g}, expected 0..1 (keypoints, masks, angles or logits read as classes?)"
        )


def class_names(text: str | None, head: Head) -> list[str]:
    """Names from the metadata, by class number; "class 0", ... where there are none.

    Where the output does not tell how many classes there are, the last name stands for all further numbers.

    Raises:
        ModelError: names that cannot be read, or another number of them than the output has classes.
    """
    count = head.classes
    if text is None:
        return [f"class {number}" for number in range(count or 1000)]
    names = _read_names(text)
    if count is not None and len(names) != count:
        raise ModelError(f"{len(names)} class names in its metadata, but {count} rows of class scores in its output")
    return names if count is not None else [*names, "unnamed"]


def _read_names(text: str) -> list[str]:
    for read in (json.loads, ast.literal_eval):
        try:
            names = read(text)
            order = sorted(names, key=int) if isinstance(names, dict) else []
        except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError):  # as `ast` documents
            continue
        if isinstance(names, dict) and names:
            return [str(names[key]) for key in order]
        if isinstance(names, list) and names:
            return [str(name) for name in names]
    raise ModelError(f"class names {text[:80]!r} in its metadata; expected such as {{0: 'person', 1: 'car'}}")
