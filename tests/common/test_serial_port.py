"""A serial port that is lost while it is being set up is tried again like any other."""

from __future__ import annotations

import errno
import os
import pty
import termios

import pytest

from common.bus.status import Report
from common.serial_port import PORT_ERRORS, explain
from common.source_url import SourceUrl
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.devices import Vesc
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.source import SerialBytes


@pytest.fixture
def lost_while_set_up(monkeypatch: pytest.MonkeyPatch) -> str:
    """A port whose settings cannot be written."""

    def lost(*_: object) -> None:
        raise termios.error(errno.EIO, "Input/output error")

    _, follower = pty.openpty()
    monkeypatch.setattr(termios, "tcsetattr", lost)
    return os.ttyname(follower)


def test_an_error_of_the_terminal_is_explained_by_its_number() -> None:
    assert isinstance(termios.error(errno.EIO, "x"), PORT_ERRORS)
    assert "permission denied" in explain("/dev/ttyACM0", termios.error(errno.EACCES, "x"), was_open=False)


def test_a_device_of_the_vehicle_says_that_it_is_lost(lost_while_set_up: str) -> None:
    with pytest.raises(OSError, match="cannot be opened"):
        next(iter(Vesc(SourceUrl("vesc", lost_while_set_up), EgoConfig()).readings()))


class Enough(Exception):
    """Instead of the pause before the next attempt."""


def test_the_lidar_says_that_its_port_is_lost_and_goes_on(
    lost_while_set_up: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pause(_: float) -> None:
        raise Enough

    monkeypatch.setattr("services.jetson.lidar.source.time.sleep", pause)
    config, report = LidarConfig(), Report("t")
    port = SerialBytes(lost_while_set_up, config.serial, report, ScanDecoder(config, report, 0.0))
    with pytest.raises(Enough):
        next(port.chunks())
    status = report.snapshot()
    assert (status.state, status.counters["port_failures"]) == ("disconnected", 1)
