"""Measured motion beside the radar's estimate: which counts, and what is said when they disagree."""

from __future__ import annotations

from typing import Any

import pytest

from common.messages import EgoMotion
from services.jetson.fusion.config import FusionConfig


def run(
    bench: Any, seconds: float, measured_mps: float | None, radar_mps: float | None, sigma_mps: float = 0.05
) -> Any:
    """Both speak at 20 Hz for a while; None says nothing at all."""
    for _ in range(round(seconds / 0.05)):
        for key, speed in (("jetson0/ego/motion", measured_mps), ("pi0/radar/motion", radar_mps)):
            if speed is not None:
                bench.seq[key] = bench.seq.get(key, 0) + 1
                message = EgoMotion(
                    stamp_ns=bench.now_ns, seq=bench.seq[key], speed_mps=speed, yaw_rate_radps=None,
                    speed_sigma_mps=sigma_mps, source_kind="live",
                )  # fmt: skip
                bench.receive(key, message)
        bench.tick()
    return bench.pipeline.step.inputs


@pytest.mark.parametrize(
    ("measured", "radar", "moving"),
    [
        (None, None, None),
        (None, 0.0, False),  # nobody measures: a bare radar knows
        (None, 1.0, True),
        (0.0, None, False),
        (1.0, 1.1, True),
        (0.0, 1.0, None),  # the encoder says that it stands, the world moves past: not known to stand
        (1.0, 0.0, True),  # wheels turn, the world stands: the measured one counts
    ],
)
def test_whether_it_moves(bench: Any, measured: float | None, radar: float | None, moving: bool | None) -> None:
    bench.run(1.0)
    inputs = run(bench, 2.5, measured, radar)
    assert inputs.moving is moving
    assert inputs.speed_mps == measured
    apart = measured is not None and radar is not None and abs(measured - radar) > 0.5
    assert any("own speed: measured" in note for note in bench.health.notes) == apart


def test_a_short_or_uncertain_disagreement_is_none(bench: Any) -> None:
    bench.run(1.0)
    run(bench, 1.0, 1.0, 1.0)
    assert run(bench, 0.5, 0.0, 1.0).moving is False
    run(bench, 2.0, 0.0, 0.05)
    assert run(bench, 3.0, 0.0, 1.0, sigma_mps=0.5).moving is False
    assert not [note for note in bench.health.notes if "own speed" in note]


def test_an_old_estimate_is_none(bench: Any) -> None:
    bench.run(1.0)
    assert run(bench, 1.0, None, 0.0).moving is False
    bench.run(0.7)
    assert bench.pipeline.step.inputs.moving is None


def test_a_service_that_the_site_has_is_missed_before_it_was_ever_seen(new_bench: Any) -> None:
    bench = new_bench(FusionConfig(expects=("jetson0/ego",)))
    bench.run(1.0)
    assert bench.health.services["jetson0/ego"].state == "disconnected"
    assert "jetson0/ego: no process, the site has it" in bench.health.notes
    bench.instances |= {("jetson0", "ego", "e1")}
    bench.run(1.0)
    assert not [note for note in bench.health.notes if "the site has it" in note]
