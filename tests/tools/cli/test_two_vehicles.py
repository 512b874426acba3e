"""Two vehicles and the roadside on one bus: every command tells them apart."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from types import ModuleType

import msgspec
import pytest
from typer.testing import CliRunner

from common import topics
from common.bus.runtime import Service
from common.bus.vehicles import vehicles_in, vehicles_on_bus
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import SensorHealth, ServiceInfo, SystemHealth
from common.recording.services import running_services
from services.jetson.fusion.config import FusionConfig, SensorConfig, SensorsConfig, VehicleConfig
from spotter_tools.cli.__main__ import app
from spotter_tools.cli.connect import bus
from spotter_tools.cli.system_view import Observer
from spotter_tools.cli.top import as_text

pytestmark = pytest.mark.patient
runner = CliRunner()
HOSTS = {"0": "SAFE", "1": "IMMINENT"}


def fusion_config(number: str, zenoh: ZenohConfig) -> FusionConfig:
    own = (f"jetson{number}", f"pi{number}")
    others = tuple(f"{kind}{other}" for other in HOSTS if other != number for kind in ("jetson", "pi"))
    vehicle = VehicleConfig(name=f"car{number}", hosts=own, other_hosts=others)
    here, there = SensorConfig(host=own[0]), SensorConfig(host=own[1])
    return FusionConfig(
        host=own[0],
        ego_host=own[0],
        zenoh=zenoh,
        vehicle=vehicle,
        sensors=SensorsConfig(lidar=here, camera=here, radar=there),
    )


def health(number: str) -> SystemHealth:
    sensor = SensorHealth(state="online", reason="", since_ns=0, age_ms=9.0, rate_hz=10.0)
    return SystemHealth(
        stamp_ns=time.time_ns(), sensors={"lidar": sensor}, colour="green", summary="bar", services={},
        vehicle=f"car{number}",
    )  # fmt: skip


@pytest.fixture
def two_vehicles(zenoh_config: ZenohConfig, speakers: ModuleType) -> Iterator[str]:
    """Two fusions that speak, a radar each, and the roadside lidar's process."""
    stop = threading.Event()

    def live(number: str, level: str) -> None:
        with (
            Service("fusion", fusion_config(number, zenoh_config)) as fusion,
            Service("radar", ServiceConfig(host=f"pi{number}", zenoh=zenoh_config)),
        ):
            say_verdict, say_health = fusion.publisher(topics.FUSION_VERDICT), fusion.publisher(topics.FUSION_HEALTH)
            while not stop.wait(0.03):
                say_verdict(speakers.verdict(time.time_ns(), level))
                say_health(health(number))

    threads = [threading.Thread(target=live, args=one) for one in HOSTS.items()]
    for thread in threads:
        thread.start()
    with Service("infra_lidar", ServiceConfig(host="infra0", zenoh=zenoh_config)):
        yield zenoh_config.connect[0]
        stop.set()
        for thread in threads:
            thread.join()


VEHICLES = {"jetson0": "car0", "pi0": "car0", "jetson1": "car1", "pi1": "car1", "infra0": "roadside"}


def test_every_command_tells_two_vehicles_apart(two_vehicles: str, until: Callable[..., None]) -> None:
    at = ["--connect", two_vehicles]
    with bus(two_vehicles, "spotter") as session:
        until(lambda: vehicles_on_bus(session) == VEHICLES)
        observer = Observer(session)
        until(lambda: {one.vehicle for one in observer.overview().fusions} == {"car0", "car1"})
        until(lambda: all(one.verdict and one.colour for one in observer.overview().fusions))
        until(lambda: len(observer.overview().services) == 5)
        overview, vehicles = observer.overview(), observer.vehicles()
        observer.close()
        recorded = running_services(session)
    # top
    text = as_text(overview)
    assert "car0: SAFE" in text[1]
    assert "car1: IMMINENT" in text[3]
    assert any(line.startswith("car1 pi1/radar") for line in text)
    assert any(line.startswith("car1: LiDAR") for line in text)
    # metrics, recordings
    assert vehicles == VEHICLES
    assert {name: about["vehicle"] for name, about in recorded.items()} == {
        "jetson0/fusion": "car0", "pi0/radar": "car0", "jetson1/fusion": "car1", "pi1/radar": "car1",
        "infra0/infra_lidar": "roadside",
    }  # fmt: skip
    # ls
    lines = runner.invoke(app, ["ls", *at]).stdout.splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["car0", "jetson0/fusion"], ["car0", "pi0/radar"], ["car1", "jetson1/fusion"], ["car1", "pi1/radar"],
        ["roadside", "infra0/infra_lidar"],
    ]  # fmt: skip
    rows = [json.loads(line) for line in runner.invoke(app, ["ls", "--json", *at]).stdout.splitlines()]
    assert {row["host"]: row["vehicle"] for row in rows} == VEHICLES
    # health
    shown = runner.invoke(app, ["health", "--fusion-host", "jetson1", *at])
    assert "IMMINENT" in shown.stdout
    assert "car1: GREEN" in shown.stdout
    # drill
    refused = runner.invoke(app, ["drill", "--running", *at])
    assert (refused.exit_code, "choose one with --vehicle; there is car0, car1" in refused.stderr) == (2, True)
    unknown = runner.invoke(app, ["drill", "--running", "--vehicle", "car7", *at])
    assert (unknown.exit_code, "no such vehicle on the bus; there is car0, car1" in unknown.stderr) == (2, True)


def test_what_is_no_answer_of_a_fusion_names_no_vehicle() -> None:
    nameless = ServiceInfo(
        stamp_ns=1, service="fusion", host="jetson0", instance="a", version="0", config_hash="", topics=[],
        started_ns=1, pid=1, config={"vehicle": {"name": "", "hosts": ["jetson0"]}},
    )  # fmt: skip
    assert vehicles_in([b"", b"nonsense", encode(nameless)]) == {}
    strange = msgspec.structs.replace(nameless, config={"vehicle": {"name": "a", "hosts": 3, "roadside_hosts": None}})
    assert vehicles_in([encode(strange)]) == {}
