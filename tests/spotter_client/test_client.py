"""The notebook API against real services of this process, and the examples as they are shipped."""

from __future__ import annotations

import importlib.util
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
import zenoh

from common import topics
from common.bus.runtime import Service
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import CameraDetections, LidarZone, LidarZones, RadarTrack, RadarTracks
from spotter_client import ServiceInfo, ServiceStatus, Verdict, connect

pytestmark = pytest.mark.patient

EXAMPLES = Path(__file__).parents[2] / "examples"
ZONES, TRACKS = "jetson0/lidar/zones", "pi0/radar/tracks"


def verdict(level: str) -> Verdict:
    return Verdict(
        stamp_ns=time.time_ns(), level=level, rule="R1-worst-case", because="lidar sees something at 0.61 m",  # type: ignore[arg-type]
        inputs={}, confirmed=False, suppressed=False, advisory=None, blind=False,
        permission={"SAFE": "GO", "CAUTION": "SLOW"}[level],  # type: ignore[arg-type]
    )  # fmt: skip


def zones() -> LidarZones:
    free = LidarZone(nearest_m=None, points=0, level="SAFE")
    seen = LidarZone(nearest_m=0.61, points=9, level="CAUTION")
    return LidarZones(stamp_ns=time.time_ns(), left=free, centre=seen, right=free, level="CAUTION", raw_level="CAUTION")


def tracks() -> RadarTracks:
    track = RadarTrack(
        track_id=1, range_m=4.2, azimuth_rad=0.1, velocity_mps=-1.5, age_frames=12, approaching=True, moving=True,
        ttc_s=2.8, level="CAUTION", snr_db=18.0,
    )  # fmt: skip
    return RadarTracks(stamp_ns=time.time_ns(), tracks=[track], level="CAUTION", settled=True, noise_floor_db=-60.0)


def camera() -> CameraDetections:
    return CameraDetections(stamp_ns=time.time_ns(), detections=[], brightness=99.0, level=None, image_size_px=(64, 48))


@pytest.fixture
def endpoint(zenoh_config: ZenohConfig) -> Iterator[str]:
    """Fusion, lidar, radar and camera that speak at 50 Hz; the verdict changes all the time."""
    stop = threading.Event()
    hosts = {"fusion": "jetson0", "lidar": "jetson0", "camera": "jetson0", "radar": "pi0"}

    def speak(name: str) -> None:
        with Service(name, ServiceConfig(host=hosts[name], zenoh=zenoh_config)) as service:
            topic = {
                "fusion": topics.FUSION_VERDICT, "lidar": topics.LIDAR_ZONES, "camera": topics.CAMERA_DETECTIONS,
                "radar": topics.RADAR_TRACKS,
            }[name]  # fmt: skip
            publish, turn = service.publisher(topic), 0
            while not stop.wait(0.02):
                turn += 1
                message = {"lidar": zones, "camera": camera, "radar": tracks}.get(
                    name, lambda turn=turn: verdict("SAFE" if turn % 2 else "CAUTION")
                )()
                publish(message)

    threads = [threading.Thread(target=speak, args=(name,)) for name in hosts]
    for thread in threads:
        thread.start()
    yield zenoh_config.connect[0]
    stop.set()
    for thread in threads:
        thread.join()


def test_latest_waits_once_and_then_follows(endpoint: str, until: Callable[..., None]) -> None:
    with connect(endpoint) as bus:
        first = bus.latest(ZONES, LidarZones)
        assert first.centre.nearest_m == pytest.approx(0.61)
        until(lambda: bus.latest(ZONES, LidarZones).seq != first.seq, budget_s=20)
        assert bus.latest("jetson0/lidar/status").state == "online"


def test_nothing_is_an_error_with_a_hint(endpoint: str) -> None:
    with connect(endpoint) as bus, pytest.raises(TimeoutError, match="pi9/radar/tracks"):
        bus.latest("pi9/radar/tracks", timeout_s=0.1)


def test_another_type_than_expected_is_refused(endpoint: str) -> None:
    with connect(endpoint) as bus, pytest.raises(TypeError, match="expected Verdict, this key carries LidarZones"):
        bus.latest(ZONES, Verdict)


def test_a_bus_in_notebook_cells(endpoint: str) -> None:
    bus = connect(endpoint)
    assert bus.latest("jetson0/fusion/verdict", Verdict).level
    bus.close()
    bus.close()
    with pytest.raises(zenoh.ZError):
        bus.services()


def test_a_stream_ends_by_count_and_by_time(endpoint: str) -> None:
    with connect(endpoint) as bus:
        levels = [one.level for one in bus.stream("*/fusion/verdict", Verdict, count=10)]
        assert len(levels) == 10
        assert set(levels) == {"SAFE", "CAUTION"}
        with pytest.warns(UserWarning, match=r"nobody publishes nobody/fusion/verdict; did you mean jetson0/fusion/"):
            assert list(bus.stream("nobody/fusion/verdict", seconds=0.05)) == []


def test_several_keys_come_with_their_names(endpoint: str) -> None:
    with connect(endpoint) as bus:
        keys: set[str] = set()
        for received in bus.arrivals("*/*/*", seconds=20):
            keys.add(received.key)
            if {ZONES, TRACKS} <= keys:
                break
    assert {ZONES, TRACKS} <= keys


def test_questions_are_answered_by_everybody(endpoint: str) -> None:
    with connect(endpoint) as bus:
        bus.latest(TRACKS)
        bus.latest(ZONES)
        assert {info.service for info in bus.query("*/*/info", ServiceInfo)} >= {"lidar", "radar"}
        (status,) = bus.query("pi0/radar/status", ServiceStatus)
        assert status.published > 0
        assert bus.query("nobody/there/status", timeout_s=0.2) == []
        here = {(one.host, one.name): one for one in bus.services()}
    assert here["pi0", "radar"].info is not None
    assert here["pi0", "radar"].state == "online"


def test_nonsense_is_counted_and_skipped(endpoint: str) -> None:
    with connect(endpoint) as bus:
        stream = bus.arrivals("mars/fusion/verdict", seconds=10)
        stop = threading.Event()

        def shout() -> None:
            while not stop.wait(0.01):
                bus.session.put("mars/fusion/verdict", b"nonsense")
                if bus.refused["mars/fusion/verdict"]:
                    bus.session.put("mars/fusion/verdict", encode(verdict("SAFE")))

        shouter = threading.Thread(target=shout)
        shouter.start()
        try:
            assert next(stream).message.level == "SAFE"
        finally:
            stop.set()
            shouter.join()
        assert bus.refused["mars/fusion/verdict"] >= 1


def test_no_router_is_said_in_a_sentence() -> None:
    with pytest.raises(ConnectionError, match="spotter router"), connect("tcp/127.0.0.1:1", give_up_after_s=0.5):
        pass


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_example_watch_verdict(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = example("watch_verdict").main(endpoint, 1.0)
    assert "CAUTION -> SLOW: lidar sees something at 0.61 m" in lines
    assert capsys.readouterr().out.splitlines() == lines


def test_example_nearest_obstacle(endpoint: str) -> None:
    nearest_m = example("nearest_obstacle").main(endpoint)
    assert nearest_m == {"lidar": pytest.approx(0.61), "radar": pytest.approx(4.2), "camera": None}


def test_example_who_is_there(endpoint: str) -> None:
    with connect(endpoint) as bus:
        bus.latest(TRACKS)  # the service is up
    assert "radar" in {service.name for service in example("who_is_there").main(endpoint)}


def test_every_example_is_tested() -> None:
    tested = {name.removeprefix("test_example_") for name in globals() if name.startswith("test_example_")}
    elsewhere = {"ros2_peer"}  # tests/tools/ros2/test_another_hand.py
    assert tested | elsewhere == {path.stem for path in EXAMPLES.glob("*.py")}
