"""The whole pipeline on the simulated camera, with the shipped demo network."""

from __future__ import annotations

import numpy as np
import pytest

from common.codec import decode, encode
from common.messages import LEVELS, CameraDetections, Level
from services.jetson.camera.config import CameraConfig, DetectorConfig
from services.jetson.camera.detector import Detector
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.source import fitted
from spotter_sim import camera as simulated
from spotter_sim.truth import expect

PERIOD_NS = 66_666_667


@pytest.fixture(scope="module")
def pipeline() -> CameraPipeline:
    return CameraPipeline(fitted(CameraConfig(source="sim:crossing")))


def run(pipeline: CameraPipeline, scenario: str, times_s: np.ndarray) -> list[CameraDetections]:
    return [pipeline.process(int(t * 1e9), simulated.image(scenario, float(t))) for t in times_s]


def test_the_crossing_is_seen_as_it_is(pipeline: CameraPipeline) -> None:
    """Level against truth twice a second, a quarter of a second allowed to either side.

    A box that is cut off may say one band more: its car is taken for a full-sized one, the simulated one is small.
    """
    times_s = np.arange(0.25, 15.0, 0.5)
    too_low, too_high = [], []
    for t_s, seen in zip(times_s, run(pipeline, "crossing", times_s), strict=True):
        assert seen.state == "online"
        rank = LEVELS.index(seen.level or "SAFE")
        near_in_time = [expect("crossing", t_s + shift).camera_level for shift in (-0.25, 0.0, 0.25)]
        allowed = [LEVELS.index(level or "SAFE") for level in near_in_time]
        cut_off = any(detection.truncated and detection.in_zone for detection in seen.detections)
        if rank < min(allowed):
            too_low.append((t_s, seen.level))
        if rank > max(allowed) + cut_off:
            too_high.append((t_s, seen.level))
    assert len(too_low) <= 1, too_low
    assert not too_high


class NumbersLost(Detector):
    """A network that has gone wrong: half precision that overflows, or broken memory."""

    lost = np.nan

    def infer(self, blob: np.ndarray) -> np.ndarray:
        output = super().infer(blob)
        output[..., 0] = self.lost
        return output


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_a_network_that_gives_no_numbers_has_not_seen_a_free_way(lost: float) -> None:
    detector = NumbersLost(DetectorConfig())
    detector.lost = lost
    (seen,) = run(CameraPipeline(CameraConfig(), detector), "crossing", np.array([5.75]))
    assert (seen.state, seen.detections, seen.level) == ("degraded", [], None)
    assert "not finite" in seen.reason
    assert seen.cover is not None
    assert seen.cover.far_m == [0.0]


@pytest.mark.parametrize(("label", "t_s", "level"), [("person", 5.75, "IMMINENT"), ("car", 12.5, "CAUTION")])
def test_who_stands_ahead_is_named_and_near(pipeline: CameraPipeline, label: str, t_s: float, level: Level) -> None:
    seen = run(pipeline, "crossing", np.array([t_s]))[0]
    best = max((d for d in seen.detections if d.in_zone), key=lambda d: d.confidence)
    true = min(simulated.boxes("crossing", t_s), key=lambda box: box.distance_m)
    assert (best.label, true.label) == (label, label)
    assert best.nearest_m is not None
    assert true.distance_m - 0.6 < best.nearest_m < true.distance_m + 0.1
    assert best.truncated
    assert seen.level in (level, "IMMINENT")


def test_nothing_is_seen_where_nothing_is(pipeline: CameraPipeline) -> None:
    for seen in run(pipeline, "empty", np.arange(0.0, 10.0, 0.4)):
        assert seen.detections == []
        assert seen.level is None
        assert seen.state == "online"


def test_darkness_clears_the_detections_at_once() -> None:
    pipeline = CameraPipeline(fitted(CameraConfig(source="sim:crossing")))
    image = simulated.image("crossing", 5.0)
    assert pipeline.process(0, image).detections
    dark = pipeline.process(PERIOD_NS, image // 8)
    assert (dark.state, dark.detections, dark.level) == ("degraded", [], None)
    assert dark.reason.startswith("dark: mean brightness")
    assert "inference" not in dark.stage_ms
    back = [pipeline.process((2 + i) * PERIOD_NS, simulated.image("crossing", 5.0 + i / 100)) for i in range(3)]
    assert [seen.state for seen in back] == ["degraded", "degraded", "online"]
    assert back[-1].detections


def test_a_frozen_picture_clears_the_detections_after_a_second() -> None:
    pipeline = CameraPipeline(fitted(CameraConfig(source="sim:crossing")))
    image = simulated.image("crossing", 5.0)
    states = [pipeline.process(i * PERIOD_NS, image) for i in range(17)]
    assert states[10].detections
    assert states[-1].state == "degraded"
    assert states[-1].reason.startswith("frozen")
    assert states[-1].detections == []


@pytest.mark.parametrize("shape", [(480, 640), (480, 640, 4), (0, 640, 3)])
def test_what_is_no_picture_is_refused(pipeline: CameraPipeline, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected a picture \(H, W, 3\) uint8"):
        pipeline.process(0, np.zeros(shape, np.uint8))


@pytest.mark.parametrize("shape", [(33, 47, 3), (1080, 1920, 3), (600, 100, 3), (1, 1, 3)])
def test_pictures_of_any_size_pass(shape: tuple[int, ...]) -> None:
    pipeline = CameraPipeline(CameraConfig())
    noise = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    assert pipeline.process(0, noise).image_size_px == (shape[1], shape[0])


def test_the_same_picture_gives_the_same_message_and_it_travels() -> None:
    image = simulated.image("crossing", 12.0)
    one, other = (CameraPipeline(CameraConfig()).process(7, image) for _ in range(2))
    other.stage_ms = one.stage_ms
    assert one == other
    assert decode(encode(one), CameraDetections) == one
    assert set(one.stage_ms) == {"health", "preprocess", "inference", "postprocess", "distance"}
