"""Two vehicles on one bus, and two sites whose networks are linked: each fusion decides from its own sensors."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh

from common import topics
from common.bus.runtime import Service
from common.bus.session import build, open_session
from common.codec import decode
from common.config import ServiceConfig, ZenohConfig
from common.host.process_plan import plan_of
from common.host.site import HostConfig, ServicePlace, Site
from common.messages import LidarZone, LidarZones, SystemHealth, Verdict

pytestmark = [pytest.mark.system, pytest.mark.whole]
VEHICLE = {"jetson": ("lidar", "camera", "fusion"), "pi": ("radar",)}
SPEAKING_S = 3.0


FOLDER = tempfile.TemporaryDirectory()  # where all of them run: what one remembers is not the other's


def two_vehicles() -> Site:
    hosts = {"infra0": HostConfig(address="10.0.0.9", services={"infra_lidar": ServicePlace()})}
    for number in (0, 1):
        for kind, names in VEHICLE.items():
            services = {name: ServicePlace() for name in names}
            address = f"10.0.{number}.{len(names)}"
            hosts[f"{kind}{number}"] = HostConfig(vehicle=f"car{number}", address=address, services=services)
    return Site(hosts=hosts, accept_simulated=True)


def fusion(host: str, bus: ZenohConfig, *more: str) -> subprocess.Popen[str]:
    """As ``spotter up HOST`` starts it, on the given router."""
    settings = (
        f'zenoh.connect=["{bus.connect[0]}"]',
        f"zenoh.namespace={bus.namespace}",
        f"host={host}",
        *plan_of(two_vehicles(), host, None).settings["fusion"],
    )
    command = [str(Path(sys.executable).with_name("spotter-fusion"))]
    for setting in (*settings, *more):
        command += ["--set", setting]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=FOLDER.name)


def zones(near: bool) -> LidarZones:
    free = LidarZone(nearest_m=None, points=0, level="SAFE")
    centre = LidarZone(nearest_m=0.3, points=9, level="IMMINENT") if near else free
    level = centre.level
    return LidarZones(stamp_ns=time.time_ns(), left=free, centre=centre, right=free, level=level, raw_level=level)


@dataclass
class Place:
    """One of two: how its services reach their router, and the name of the host on which lidar and fusion run."""

    zenoh: ZenohConfig
    host: str


def decided(places: dict[str, Place], *more: str) -> tuple[dict[str, list[Verdict]], dict[str, SystemHealth]]:
    """By place, what each fusion said while the first place's lidar saw an obstacle and the second's saw none."""
    verdicts: dict[str, list[Verdict]] = {name: [] for name in places}
    healths: dict[str, SystemHealth] = {}
    started = threading.Event()

    def noter(name: str) -> Callable[[zenoh.Sample], None]:
        def note(sample: zenoh.Sample) -> None:
            payload = sample.payload.to_bytes()
            if str(sample.key_expr).endswith("/verdict"):
                verdicts[name].append(decode(payload, Verdict))
            else:
                healths[name] = decode(payload, SystemHealth)
            if all(verdicts.values()) and len(healths) == len(places):
                started.set()

        return note

    with ExitStack() as stack:
        speak = {}
        for name, place in places.items():
            process = stack.enter_context(fusion(place.host, place.zenoh, *more))
            stack.callback(process.terminate)
            session = stack.enter_context(open_session(place.zenoh))
            for topic in (topics.FUSION_VERDICT, topics.FUSION_HEALTH):
                stack.callback(session.declare_subscriber(topic.key(place.host), noter(name)).undeclare)
            lidar = stack.enter_context(Service("lidar", ServiceConfig(host=place.host, zenoh=place.zenoh)))
            speak[name] = lidar.publisher(topics.LIDAR_ZONES)
        assert started.wait(30)
        deadline_s, pause = time.monotonic() + SPEAKING_S, threading.Event()
        while time.monotonic() < deadline_s:
            for index, publish in enumerate(speak.values()):
                publish(zones(near=index == 0))
            pause.wait(0.05)
        return dict(verdicts), dict(healths)  # as they are while all speak


def test_what_one_vehicle_sees_never_decides_for_the_other(zenoh_config: ZenohConfig) -> None:
    verdicts, healths = decided({host: Place(zenoh_config, host) for host in ("jetson0", "jetson1")})
    assert any(verdict.level == "IMMINENT" for verdict in verdicts["jetson0"])
    assert not any(verdict.level == "IMMINENT" for verdict in verdicts["jetson1"])
    assert healths["jetson1"].sensors["lidar"].state == "online"
    assert {name: health.vehicle for name, health in healths.items()} == {"jetson0": "car0", "jetson1": "car1"}
    assert not any("unexpected host" in note for health in healths.values() for note in health.notes)
    assert not any(name.partition("/")[0] in ("jetson0", "pi0") for name in healths["jetson1"].services)


def test_two_sites_with_linked_networks_and_the_same_host_names_keep_apart(
    router_endpoint: str, free_ports: Callable[[], int]
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_ports()}"
    second = ZenohConfig(mode="router", connect=(router_endpoint,), listen=(endpoint,), namespace="")
    with zenoh.open(build(second)) as router:
        places = {
            "north": Place(ZenohConfig(connect=(router_endpoint,), namespace="north"), "jetson0"),
            "south": Place(ZenohConfig(connect=(endpoint,), namespace="south"), "jetson0"),
        }
        crossed: list[zenoh.Sample] = []
        router.declare_subscriber("north/jetson0/fusion/verdict", crossed.append)
        verdicts, healths = decided(places)
    assert crossed  # the networks are linked indeed
    assert any(verdict.level == "IMMINENT" for verdict in verdicts["north"])
    assert not any(verdict.level == "IMMINENT" for verdict in verdicts["south"])
    for health in healths.values():
        assert health.sensors["lidar"].state == "online"
        assert health.services["jetson0/lidar"].instances == 1  # the other site's lidar of that name is not seen
        assert not any("claim" in note for note in health.notes)


def test_a_fusion_of_another_vehicle_s_sensors_does_not_start(zenoh_config: ZenohConfig) -> None:
    process = fusion("jetson1", zenoh_config, "sensors.lidar.host=jetson0")
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 2
    assert "[sensors.lidar] host = 'jetson0': not a host of vehicle 'car1'; allowed: jetson1, pi1" in stderr
