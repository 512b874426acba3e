"""The boxes of one frame as the tracker takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, get_args

import numpy as np

from common.geometry import transform_points
from common.messages import ObjectLabel, check_shape
from services.infra_lidar.classification.classes import CLASSES, LABELS

assert set(LABELS) == set(get_args(ObjectLabel))

CLASS_COUNT = len(CLASSES)
DETECTION = np.dtype(
    [
        ("position", np.float64, 3),  # centre x, y, z, m, map frame
        ("size", np.float64, 3),  # length, width, height, m
        ("yaw", np.float64),  # rad
        ("class_probabilities", np.float64, CLASS_COUNT),
        ("label", np.int64),  # index into ``LABELS``
        ("confidence", np.float64),  # 0..1
        ("points", np.int64),
    ]
)
DetectionRecord: TypeAlias = Any  # one record of a ``DETECTION`` array; numpy has no static type for its fields

_LABEL_INDEX: dict[str, int] = {label: index for index, label in enumerate(LABELS)}


@dataclass(frozen=True)
class Detections:
    """K boxes of one frame, metres and radians.

    ``position_m`` (K, 3) centre, ``size_m`` (K, 3) length, width, height, ``yaw_rad`` (K,), ``labels`` (K,) of
    ``LABELS`` or their index in it, ``confidence`` (K,) in 0..1, ``points`` (K,) or None, ``probabilities`` (K, C) over
    ``CLASSES`` or None (derived from label and confidence), ``T_map_source`` (4, 4): pose of the boxes' frame, upright,
    in the map frame.

    Raises:
        ValueError: a shape does not fit, or a label is not in ``LABELS``.
    """

    position_m: np.ndarray
    size_m: np.ndarray
    yaw_rad: np.ndarray
    labels: Sequence[str] | np.ndarray
    confidence: np.ndarray
    points: np.ndarray | None = None
    probabilities: np.ndarray | None = None
    T_map_source: np.ndarray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        count = len(self.labels)
        shapes = {
            "position_m": (count, 3), "size_m": (count, 3), "yaw_rad": (count,), "confidence": (count,),
            "T_map_source": (4, 4),
        }  # fmt: skip
        for name, shape in shapes.items():
            check_shape(self, name, np.asarray(getattr(self, name)), *shape)
        if isinstance(self.labels, np.ndarray):
            if count and not 0 <= self.labels.min() <= self.labels.max() < len(LABELS):
                raise ValueError(f"labels: {sorted(set(self.labels.tolist()))} are no index of {', '.join(LABELS)}")
        elif not _LABEL_INDEX.keys() >= set(self.labels):
            unknown = sorted(set(self.labels) - _LABEL_INDEX.keys())
            raise ValueError(f"labels: {unknown} not among {', '.join(LABELS)}")

    def records(self) -> np.ndarray:
        """(K,) ``DETECTION`` in the map frame, the tracker's input."""
        labels = self.labels
        if not isinstance(labels, np.ndarray):
            labels = np.array([_LABEL_INDEX[label] for label in labels], np.int64)
        box = np.column_stack((self.position_m, self.size_m, self.yaw_rad))
        return detection_records(
            box, labels, self.confidence, self.points, self.probabilities, T_map_source=self.T_map_source
        )


def detection_records(
    box: np.ndarray, labels: np.ndarray, confidence: np.ndarray, points: np.ndarray | None = None,
    probabilities: np.ndarray | None = None, *, T_map_source: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(K,) ``DETECTION`` in the map frame, of boxes (K, 7 or more) in the source frame: centre x, y, z, length, width,
    height (m), yaw (rad).

    labels: (K,) indices into ``LABELS``. The other arguments as in ``Detections``, which also checks them.
    """
    records = np.empty(len(box), DETECTION)
    records["position"] = transform_points(T_map_source, box[:, :3].astype(np.float64))
    records["size"] = box[:, 3:6]
    records["yaw"] = box[:, 6] + np.arctan2(T_map_source[1, 0], T_map_source[0, 0])
    records["label"] = labels
    records["confidence"] = np.clip(confidence, 0.0, 1.0)
    records["points"] = 0 if points is None else points
    records["class_probabilities"] = (
        _probabilities_of(labels, records["confidence"]) if probabilities is None else probabilities
    )
    return records


def _probabilities_of(labels: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """(K, C): the confidence for the labelled class and the rest evenly for the others; even for "unknown"."""
    known = np.flatnonzero(labels < CLASS_COUNT)
    share = np.full(len(labels), 1.0 / CLASS_COUNT)
    share[known] = confidence[known]
    probabilities = np.repeat((1.0 - share)[:, None] / (CLASS_COUNT - 1), CLASS_COUNT, axis=1)
    probabilities[known, labels[known]] = share[known]
    return probabilities
