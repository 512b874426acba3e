"""The tracker's input: invalid detections are refused, equivalent ones give equal records."""

from __future__ import annotations

import numpy as np
import pytest

from common.geometry import rotation_z, transform
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.tracking.detections import DETECTION, Detections

CAR, PERSON = (4.4, 1.8, 1.5), (0.5, 0.5, 1.7)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("position_m", np.zeros((2, 2))), ("size_m", np.zeros(3)), ("yaw_rad", np.zeros(3)),
        ("labels", ["car", "tank"]), ("labels", np.array([1, 6])), ("labels", np.array([-1, 0])),
        ("T_map_source", np.eye(3)),
    ],
)  # fmt: skip
def test_detections_that_do_not_fit_are_refused(field: str, value: object) -> None:
    good = {
        "position_m": np.zeros((2, 3)), "size_m": np.ones((2, 3)), "yaw_rad": np.zeros(2), "labels": ["car", "car"],
        "confidence": np.ones(2),
    }  # fmt: skip
    with pytest.raises(ValueError, match=field):
        Detections(**(good | {field: value}))


def test_labels_may_be_indices_and_boxes_in_another_frame() -> None:
    """A quarter turn to the left, and 100 m on."""
    T = transform(rotation_z(np.pi / 2), np.array([100.0, 0.0, 5.0]))
    own = Detections(
        position_m=np.array([[2.0, 1.0, -4.0], [8.0, 0.0, -4.0]]), size_m=np.array([CAR, PERSON]),
        yaw_rad=np.array([0.2, 0.0]), labels=np.array([CLASSES.index("car"), CLASSES.index("pedestrian")]),
        confidence=np.array([0.9, 0.8]), T_map_source=T,
    )  # fmt: skip
    in_map = Detections(
        position_m=np.array([[99.0, 2.0, 1.0], [100.0, 8.0, 1.0]]), size_m=np.array([CAR, PERSON]),
        yaw_rad=np.array([0.2, 0.0]) + np.pi / 2, labels=["car", "pedestrian"], confidence=np.array([0.9, 0.8]),
    )  # fmt: skip
    for one, other in zip(own.records(), in_map.records(), strict=True):
        for name in DETECTION.names or ():
            assert one[name] == pytest.approx(other[name]), name
