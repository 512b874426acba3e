"""What `spotter-infra-lidar look` says of a sensor that sends: which it is, its packets, turns and returns."""

from __future__ import annotations

from collections.abc import Callable

from common.bus.look import Look
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.look import looks
from tests.infra_lidar.made_packets import sending, vls_packet


def test_a_sensor_that_sends_is_told_with_its_packets(free_ports: Callable[[], int]) -> None:
    port = free_ports()
    packets = [vls_packet(0.6 * k % 360.0, time_us=166 * k) for k in range(600)]
    with sending(packets, port):
        seen: Look = next(looks(InfraLidarConfig(source=f"velodyne://127.0.0.1:{port}"), 0.5))
    assert seen.sees, seen
    assert seen.what.startswith("VLS-128, ")
    assert "packets a turn" in seen.what
    assert "from 10.0 to 10.0 m" in seen.what  # every laser of these packets sees a sphere of 10 m
