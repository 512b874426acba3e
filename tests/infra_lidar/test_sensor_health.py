"""When the sensor says that it cannot see."""

import pytest

from services.infra_lidar.config import VisibilityConfig
from services.infra_lidar.sensor_health import FrameQuality, FrameStatistics, VisibilityMonitor

GOOD = FrameStatistics(returns=180_000, near=500, beams=128, sectors=72)
FINE = FrameQuality(packets=600)


def _after(statistics, quality=FINE, total_ms=10.0, fault="", frames=12):
    """State and reason when a good sensor turns into this."""
    monitor = VisibilityMonitor(VisibilityConfig())
    for _ in range(30):
        assert monitor.update(GOOD, FINE, 10.0, "") == ("online", "")
    for _ in range(frames):
        answer = monitor.update(statistics, quality, total_ms, fault)
    return answer


@pytest.mark.parametrize(
    ("statistics", "words"),
    [
        (FrameStatistics(300, 0, 128, 72), "only 300 returns"),
        (FrameStatistics(60_000, 500, 128, 72), "60000 returns a frame instead of"),
        (FrameStatistics(170_000, 60_000, 128, 72), "rain, fog or dirt"),
        (FrameStatistics(150_000, 500, 90, 72), "38 of 128 beams are lost"),
        (FrameStatistics(150_000, 500, 128, 40), "32 of 72 directions are covered"),
    ],
)
def test_lost_sight_is_named(statistics, words):
    state, reason = _after(statistics)
    assert state == "degraded"
    assert words in reason


@pytest.mark.parametrize(
    ("quality", "total_ms", "fault", "words"),
    [
        (FrameQuality(570, packets_lost=30), 10.0, "", "5.0% of the packets are lost"),
        (FrameQuality(600, complete=False), 10.0, "", "revolutions are incomplete"),
        (FINE, 150.0, "", "150 ms a frame, 100 are allowed"),
        (FINE, 10.0, "the sensor has moved", "the sensor has moved"),
    ],
)
def test_other_reasons_are_named(quality, total_ms, fault, words):
    state, reason = _after(GOOD, quality, total_ms, fault)
    assert state == "degraded"
    assert words in reason


def test_one_bad_frame_changes_nothing():
    assert _after(FrameStatistics(60_000, 500, 128, 72), frames=1)[0] == "online"


def test_usual_is_not_learned_from_a_covered_sensor():
    assert _after(FrameStatistics(60_000, 500, 128, 72), frames=400)[0] == "degraded"


def test_a_cloud_without_rings_has_no_beams_to_lose():
    monitor = VisibilityMonitor(VisibilityConfig())
    for _ in range(20):
        assert monitor.update(FrameStatistics(9000, 0, 0, 72), None, 1.0, "")[0] == "online"


def test_sight_comes_back():
    monitor = VisibilityMonitor(VisibilityConfig())
    for statistics in [GOOD] * 20 + [FrameStatistics(300, 0, 128, 72)] * 20 + [GOOD] * 20:
        answer = monitor.update(statistics, FINE, 10.0, "")
    assert answer == ("online", "")
