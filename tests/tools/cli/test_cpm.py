"""`spotter cpm` over a real router and a real UDP socket, and what it refuses."""

from __future__ import annotations

import errno
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from typer.testing import CliRunner

pytest.importorskip("asn1tools", reason="needs the cpm extra")

from common.bus.runtime import Service
from common.codec import DecodeError
from common.codec import decode as from_wire
from common.config import ServiceConfig, ZenohConfig
from common.messages import ObjectTracks
from common.topics import INFRA_TRACKS
from spotter_tools.cli.__main__ import app
from spotter_tools.cpm.codec import decode

pytestmark = [pytest.mark.patient]
SITE = "[map]\nlatitude_deg = 52.5\nlongitude_deg = 13.25\nheading_deg = 90.0\n"


@pytest.fixture
def speaking_roadside(zenoh_config: ZenohConfig, speakers: ModuleType) -> Iterator[str]:
    """The endpoint of a router at which infra0 tracks a car, at 50 Hz."""
    stop = threading.Event()

    def speak() -> None:
        with Service("infra_lidar", ServiceConfig(host="infra0", zenoh=zenoh_config)) as service:
            publish = service.publisher(INFRA_TRACKS)
            while not stop.wait(0.02):
                publish(speakers.objects(time.time_ns()))

    thread = threading.Thread(target=speak)
    thread.start()
    yield zenoh_config.connect[0]
    stop.set()
    thread.join()


def test_tracks_become_datagrams(speaking_roadside: str, tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text(SITE)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        radio.bind(("127.0.0.1", 0))
        radio.settimeout(10.0)
        to = f"127.0.0.1:{radio.getsockname()[1]}"
        result = CliRunner().invoke(
            app,
            ["cpm", "--to", to, "--station-id", "99", "-n", "3", "--accept-simulated", "--connect", speaking_roadside,
             "--namespace", "spotter", "--site", str(tmp_path / "site.toml")],
        )  # fmt: skip
        assert result.exit_code == 0, result.output
        received = [decode(radio.recv(4096)) for _ in range(3)]
    assert [one["header"]["stationId"] for one in received] == [99, 99, 99]
    assert [3 in one["containers"] for one in received] == [True, False, False]  # of the lidar: once a second
    (seen,) = received[0]["containers"][5]["perceivedObjects"]
    assert (seen["objectId"], seen["position"]["xCoordinate"]["value"]) == (7, 300)


def test_a_network_that_is_away_and_a_message_that_cannot_be_read_do_not_end_it(
    speaking_roadside: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "site.toml").write_text(SITE)
    faults = [OSError(errno.ENETUNREACH, "Network is unreachable"), DecodeError("ObjectTracks: truncated")]

    class Radio(socket.socket):
        def sendto(self, *_: object) -> int:
            if len(faults) == 2:
                raise faults.pop(0)
            return 1

    def read(payload: bytes, kind: type[ObjectTracks]) -> ObjectTracks:
        if len(faults) == 1:
            raise faults.pop(0)
        return from_wire(payload, kind)

    monkeypatch.setattr("spotter_tools.cli.cpm.socket.socket", Radio)
    monkeypatch.setattr("spotter_tools.cli.cpm.decode", read)
    result = CliRunner().invoke(
        app,
        ["cpm", "--to", "127.0.0.1:9", "--station-id", "99", "-n", "1", "--accept-simulated", "--namespace", "spotter",
         "--connect", speaking_roadside, "--site", str(tmp_path / "site.toml")],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert result.output.splitlines() == [
        "spotter: not sent: --to 127.0.0.1:9: Network is unreachable",
        "spotter: not sent: infra0/infra_lidar/tracks: ObjectTracks: truncated",
        "spotter: sending to 127.0.0.1:9",
    ]


@pytest.mark.parametrize(
    ("arguments", "site", "error_text"),
    [
        (["--to", "127.0.0.1:1"], "", "where the map lies is not known: give [map]"),
        (["--to", "nowhere"], SITE, "--to nowhere: expected HOST:PORT"),
        (["--to", "radio:70000"], SITE, "--to radio:70000: expected HOST:PORT"),
    ],
)
def test_what_cannot_be_sent_is_said(arguments: list[str], site: str, error_text: str, tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text(site)
    command = ["cpm", *arguments, "--station-id", "1", "--site", str(tmp_path / "site.toml")]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2
    assert error_text in result.output
