"""What `spotter-infra-lidar look` says of a sensor that sends: which it is, its packets, turns and returns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from common.bus.look import Look, PeriodSamples
from common.bus.status import Report
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.packets import Frame
from services.infra_lidar.input.range_image import Returns
from services.infra_lidar.input.velodyne import decode
from services.infra_lidar.look import describe, looks
from tests.infra_lidar.made_packets import sending, vls_packet


def test_a_sensor_that_sends_is_told_with_its_packets(free_ports: Callable[[], int]) -> None:
    port = free_ports()
    packets = [vls_packet(0.6 * k % 360.0, time_us=166 * k) for k in range(600)]
    with sending(packets, port):
        seen: Look = next(looks(InfraLidarConfig(source=f"velodyne://127.0.0.1:{port}"), 0.5))
    assert seen.sees, seen
    assert seen.what.startswith("VLS-128, ")
    assert "packets per revolution" in seen.what
    assert "from 10.0 to 10.0 m" in seen.what  # every laser of these packets sees a sphere of 10 m


def packet_of(steps: int) -> Returns:
    return decode(np.frombuffer(vls_packet(0.0, steps=steps), np.uint8)[None])


@pytest.mark.parametrize(
    ("returns", "words"),
    [
        (packet_of(0), "10.0 revolutions per second, 0 returns"),
        (packet_of(2500), "10.0 revolutions per second, 384 returns, from 10.0 to 10.0 m"),
        (np.zeros((0, 5), np.float32), "10.0 revolutions per second, 0 returns"),
        (np.array([[0, 0, 0, 1], [np.nan] * 4, [3, 4, 0, 1]], np.float32), "1 returns, from 5.0 to 5.0 m"),
    ],
)
def test_only_real_returns_are_counted(returns: Returns, words: str) -> None:
    seen = describe(PeriodSamples([(0, Frame(returns, 0))], 10.0, Report("look").snapshot()), "")
    assert seen.what.endswith(words)
    assert seen.sees == (" m" in words)
    assert ("is the window covered" in seen.do) == (not seen.sees)
