"""What stands, and what stood there: somebody stops and leaves; another radar is on from the start."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from common.messages import RadarTracks
from services.radar_pi.config import RadarConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from spotter_sim.bgt60 import LEAKAGE, Target, simulate

CONFIG = RadarConfig()
SHAPE = simulator_waveform(CONFIG.waveform)
PERIOD_S = CONFIG.waveform.frame_period_s
WALL = Target(3.2, 0.0, 0.3, 500.0)
Frame = Callable[[list[Target], int], np.ndarray]


def plain(targets: list[Target], number: int) -> np.ndarray:
    return simulate((*LEAKAGE, WALL, *targets), SHAPE, seed=number)


def body(range_m: float, speed_mps: float) -> list[Target]:
    """Trunk and limbs."""
    return [
        Target(range_m, speed_mps, 0.05, 400.0),
        Target(range_m + 0.12, 0.9 * speed_mps, -0.05, 250.0),
        Target(range_m + 0.20, 1.1 * speed_mps, 0.10, 150.0),
    ]


def play(scenes: list[list[Target]], frame: Frame = plain) -> list[RadarTracks]:
    pipeline = RadarPipeline(CONFIG)
    period_ns = round(PERIOD_S * 1e9)
    return [pipeline.process(n * period_ns, frame(targets, n)) for n, targets in enumerate(scenes)]


def test_the_track_goes_with_the_person() -> None:
    """Stops at 0.6 m for 4 s, so that the background learns the body, and leaves: nothing stays where it stood."""
    come = [body(4.0 - 1.2 * PERIOD_S * i, -1.2) for i in range(29)]
    stand = [body(0.6 + 0.002 * np.sin(0.15 * i), 0.0) for i in range(40)]
    leave = [body(0.6 + 1.3 * PERIOD_S * i, 1.3) for i in range(1, 31)]
    before = 20 + len(come) + len(stand)
    messages = play([[]] * 20 + come + stand + leave + [[]] * 30)
    assert any(message.level == "IMMINENT" for message in messages[:before])
    for message in messages[before + 4 :]:
        assert [track.range_m for track in message.tracks if track.range_m < 0.9] == []
        assert message.level == "SAFE"
        assert message.static_level != "IMMINENT"


def test_a_wall_that_a_walker_hides_for_a_moment_alarms_nobody() -> None:
    """Its echo falls while somebody stands in front of it, and comes back."""
    there, hidden = [WALL], Target(3.2, 0.0, 0.3, 5.0)

    def frame(targets: list[Target], number: int) -> np.ndarray:
        return simulate((*LEAKAGE, *(targets or there)), SHAPE, seed=number)

    messages = play([[]] * 25 + [[hidden, *body(1.5, 0.9)]] * 10 + [[]] * 40, frame)
    assert {message.level for message in messages} == {"SAFE"}


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_interference_from_the_start_is_degraded_and_not_learned(share: float) -> None:
    rng = np.random.default_rng(1)

    def disturbed(targets: list[Target], number: int) -> np.ndarray:
        frame = plain(targets, number).astype(float)
        for chirp in np.flatnonzero(rng.random(SHAPE.chirps) < share):
            at = rng.integers(0, SHAPE.samples - 24)
            frame[:, chirp, at : at + 24] += 100.0 * rng.normal(size=(len(frame), 24))
        return np.clip(np.rint(frame), 0, 4095).astype(np.uint16)

    messages = play([[]] * 90, disturbed)
    assert "interference: chirps of one frame differ by" in messages[-1].reason
    assert all(message.state == "degraded" for message in messages)  # settling first, interference from then on
    walker = [body(5.0 - 1.2 * PERIOD_S * i, -1.2) for i in range(35)]
    assert all(message.state == "online" for message in play([[]] * 20 + walker)[20:])  # a body is no interference


@pytest.mark.parametrize("speed_mps", [-0.08, -0.12])
def test_a_body_that_creeps_keeps_its_track(speed_mps: float) -> None:
    """Slower than what counts as moving: it leaves one bin and enters the next, and is no absence anywhere."""
    start_m = 1.2
    frames = round((start_m - 0.3) / (-speed_mps * PERIOD_S))
    creep = [body(start_m + speed_mps * PERIOD_S * i, speed_mps) for i in range(frames)]
    messages = play([[]] * 20 + creep)
    assert all(message.tracks for message in messages[28:])
    assert messages[-1].level != "SAFE"
