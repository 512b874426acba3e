"""Boxes of one picture alone: told apart while the vehicle drives, and only where pictures come often enough."""

from __future__ import annotations

import numpy as np
import pytest

from common.messages import Motion
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.detector import Boxes
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.repeats import Repeats
from services.jetson.fusion.readings import read_camera
from spotter_sim import camera as simulated
from spotter_tools.prove.detector import SimulatedDetector

PERIOD_NS = 66_666_667
BOX = (100.0, 100.0, 140.0, 200.0)
NONE = np.empty((0, 4))


def boxes(*rows: tuple[float, ...]) -> np.ndarray:
    return np.array(rows, float).reshape(-1, 4)


def seen(*pictures: np.ndarray, period_ns: int = PERIOD_NS) -> list[bool]:
    """Of the last picture's boxes, which were seen before."""
    repeats = Repeats()
    results = [repeats.seen_before((k + 1) * period_ns, picture) for k, picture in enumerate(pictures)]
    return [bool(one) for one in results[-1]]


@pytest.mark.parametrize(
    ("why", "before", "expected"),
    [
        ("at the same place", [boxes(BOX)], True),
        ("beside it by less than its width", [boxes((175.0, 100.0, 215.0, 200.0))], True),
        ("farther beside", [boxes((185.0, 100.0, 225.0, 200.0))], False),
        ("far less tall", [boxes((100.0, 140.0, 140.0, 200.0))], False),
        ("far taller", [boxes((100.0, 30.0, 140.0, 200.0))], False),
        ("above it", [boxes((100.0, -10.0, 140.0, 90.0))], False),
        ("nowhere", [NONE], False),
        ("missed once", [boxes(BOX), NONE], True),
        ("missed twice", [boxes(BOX), NONE, NONE], False),
    ],
)
def test_a_box_was_there_before(why: str, before: list[np.ndarray], expected: bool) -> None:
    assert seen(*before, boxes(BOX)) == [expected]


def test_without_a_recent_picture_every_box_counts() -> None:
    assert seen(boxes(BOX)) == [True]
    assert seen(NONE, boxes(BOX), period_ns=300_000_000) == [True]
    assert seen(boxes(BOX), NONE) == []


class OnePhantom(SimulatedDetector):
    """A network that shows a person in the third picture and in no other."""

    def __init__(self) -> None:
        super().__init__()
        self._pictures = 0

    def postprocess(self, *_: object) -> Boxes:
        self._pictures += 1
        rows = boxes((300.0, 100.0, 340.0, 300.0)) if self._pictures == 3 else NONE
        return Boxes(rows.astype(np.float32), np.full(len(rows), 0.9, np.float32), np.zeros(len(rows), int))


@pytest.mark.parametrize(("motion", "counts"), [(Motion(1.0), False), (Motion(0.0), True), (None, True)])
def test_a_phantom_counts_unless_the_vehicle_is_known_to_drive(motion: Motion | None, counts: bool) -> None:
    pipeline, image = CameraPipeline(CameraConfig(), OnePhantom()), simulated.image("empty", 0.0)
    for k in range(3):
        message = pipeline.process((k + 1) * PERIOD_NS, image, motion)
    (detection,) = message.detections
    assert detection.in_zone
    assert detection.seen_before == counts
    assert (message.level is not None) == counts
    assert (read_camera(message).level is not None) == counts
