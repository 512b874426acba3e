"""How fast fusion decides: the rules alone, a pipeline step, and input to verdict over real Zenoh.

    python -m benchmarks.onboard.fusion [--demo]

Input to verdict is from the moment a sensor service hands its message to the network to the moment fusion hands the
first verdict that used it to the network; both stamps come from this machine's clock. ``--demo`` measures it in the
whole demo with its six services as well.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import zenoh

from common.bus.namespace import DEMO
from common.bus.pubsub import Received
from common.bus.runtime import Service
from common.bus.session import build, open_session
from common.clock import utc_ns
from common.codec import DecodeError, decode
from common.config import ServiceConfig, ZenohConfig
from common.messages import CameraDetections, LidarZone, LidarZones, RadarTracks, Verdict
from common.topics import CAMERA_DETECTIONS, FUSION_VERDICT, LIDAR_ZONES, RADAR_TRACKS, Topic
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.verdict import FusionInputs, FusionMemory, SensorInput, fuse
from spotter_tools.ports import free_port

WRITTEN_RULES = Path(__file__).parents[2] / "tests" / "jetson" / "fusion" / "written_rules.py"
SENSORS: dict[str, tuple[Topic, str, float]] = {
    "lidar": (LIDAR_ZONES, "jetson0", 10.0),
    "radar": (RADAR_TRACKS, "pi0", 10.0),
    "camera": (CAMERA_DETECTIONS, "jetson0", 15.0),
}
SECONDS = 20.0
CLEAR = LidarZone(nearest_m=None, points=0, level="SAFE")


def message(name: str, stamp_ns: int) -> Any:
    """A sensor's message that sees nothing, stamped ``stamp_ns`` (UTC)."""
    if name == "lidar":
        return LidarZones(stamp_ns=stamp_ns, left=CLEAR, centre=CLEAR, right=CLEAR, level="SAFE", raw_level="SAFE")
    if name == "radar":
        return RadarTracks(stamp_ns=stamp_ns, tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0)
    return CameraDetections(stamp_ns=stamp_ns, detections=[], brightness=99.0, level=None, image_size_px=(640, 480))


def microseconds(work: Callable[[], object], repeat: int = 5000) -> float:
    """Best of five of the mean processor time of a call."""
    times = []
    for _ in range(5):
        start_s = time.process_time()
        for _ in range(repeat // 5):
            work()
        times.append((time.process_time() - start_s) / (repeat // 5))
    return min(times) * 1e6


def rules() -> None:
    """``fuse`` with its explanations against the plain table entry without any; each alarm begins a claim."""
    memory, plain = FusionMemory(), _written_rules()
    reference_us = microseconds(
        lambda: plain.decide(("online", 1), ("online", 1, None), ("online", 1, True), "unknown")
    )
    for what, level in (("nothing near", "SAFE"), ("three alarms that begin", "CAUTION")):
        sensor = SensorInput(state="online", level=level, age_s=0.02)  # type: ignore[arg-type]
        camera = sensor if level == "CAUTION" else SensorInput(state="online", level=None, age_s=0.02)
        inputs = FusionInputs(now_s=1.0, moving=None, lidar=sensor, radar=sensor, camera=camera)
        fuse_us = microseconds(partial(fuse, inputs, memory))
        print(f"{f'fuse(), {what}':<44} {fuse_us:8.1f} us   {fuse_us / reference_us:5.1f} x the plain table lookup")
    print(f"{'pipeline step, one new message each time':<44} {pipeline_us():8.1f} us")


def pipeline_us() -> float:
    """Microseconds of one pipeline step, with one new message each time."""
    pipeline = FusionPipeline(FusionConfig())
    present = frozenset((host, topic.service, "x") for topic, host, _ in SENSORS.values())
    turn = itertools.cycle(SENSORS)
    clock = itertools.count(1)

    def step() -> None:
        name, now_s = next(turn), 100.0 + next(clock) * 0.01
        topic, host, _ = SENSORS[name]
        now_ns = round(now_s * 1e9)
        received = Received(topic.key(host), message(name, now_ns), now_s, now_ns)
        pipeline.process(Observation(now_s=now_s, now_ns=now_ns, received=(received,), present=present))

    return microseconds(step)


class InputToVerdict:
    """Listens to inputs and verdicts; ``latencies_ms`` of every input that a verdict used."""

    def __init__(self, session: zenoh.Session) -> None:
        self.latencies_ms: list[float] = []
        self.verdicts = 0
        self._lock = threading.Lock()
        self._sent_ns: dict[tuple[str, int], int] = {}
        topics = [(name, topic) for name, (topic, _, _) in SENSORS.items()] + [("", FUSION_VERDICT)]
        self._subscribers = [session.declare_subscriber(topic.any_host, self._noter(n, topic)) for n, topic in topics]

    def close(self) -> None:
        """Stop listening."""
        for subscriber in self._subscribers:
            subscriber.undeclare()

    def restart(self) -> None:
        """Forget what was measured so far."""
        with self._lock:
            self.latencies_ms, self.verdicts = [], 0

    def _noter(self, name: str, topic: Topic) -> Callable[[zenoh.Sample], None]:
        def note(sample: zenoh.Sample) -> None:
            """Keep one message of ``topic``; what cannot be decoded is left out."""
            try:
                message = decode(sample.payload.to_bytes(), topic.message)
            except DecodeError:
                return
            with self._lock:
                if isinstance(message, Verdict):
                    self._note_verdict(message)
                else:
                    self._sent_ns[name, message.stamp_ns] = message.sent_ns

        return note

    def _note_verdict(self, verdict: Verdict) -> None:
        self.verdicts += 1
        for name, used in verdict.inputs.items():
            sent_ns = self._sent_ns.pop((name, used.stamp_ns), None)
            if sent_ns is not None:
                self.latencies_ms.append((verdict.sent_ns - sent_ns) * 1e-6)

    def line(self, what: str, seconds: float) -> str:
        """What was measured in the last ``seconds``, as a line of the table."""
        with self._lock:
            if not self.latencies_ms:
                return f"{what:<44} no input reached a verdict"
            p50, p99 = np.percentile(self.latencies_ms, (50, 99))
            count, rate_hz = len(self.latencies_ms), self.verdicts / seconds
        return f"{what:<44} p50 {p50:6.2f} ms  p99 {p99:6.2f} ms  ({count} inputs)  verdicts {rate_hz:6.1f} Hz"


@contextmanager
def publishers(endpoint: str, factor: float) -> Iterator[None]:
    """The three sensors at ``factor`` times their nominal rates."""
    stop = threading.Event()

    def publish(name: str) -> None:
        topic, host, rate_hz = SENSORS[name]
        with Service(name, ServiceConfig(host=host, zenoh=ZenohConfig(connect=(endpoint,)))) as service:
            put = service.publisher(topic)
            while not stop.wait(1.0 / (rate_hz * factor)):
                put(message(name, utc_ns()))

    threads = [threading.Thread(target=publish, args=(name,)) for name in SENSORS]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def over_zenoh() -> None:
    """A real fusion process, a router, and the sensors' messages from this process."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace="")
    command = [str(Path(sys.executable).with_name("spotter-fusion")), "--set", f'zenoh.connect=["{endpoint}"]']
    with zenoh.open(build(router)), open_session(ZenohConfig(connect=(endpoint,))) as session:
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        watch = InputToVerdict(session)
        try:
            for what, factor in (
                ("input to verdict, nominal rates", 1.0),
                ("input to verdict, 10 x nominal rates", 10.0),
            ):
                with publishers(endpoint, factor):
                    time.sleep(2.0)
                    watch.restart()
                    time.sleep(SECONDS)
                    print(watch.line(what, SECONDS))
        finally:
            watch.close()
            process.send_signal(signal.SIGTERM)
            process.wait()


def in_the_demo() -> None:
    """The whole demo: router, six services, dashboard."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = ["--listen", endpoint, "--port", str(free_port())]
    command = [str(Path(sys.executable).with_name("spotter")), "demo", *options]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        with open_session(ZenohConfig(connect=(endpoint,), namespace=DEMO), give_up_after_s=30.0) as session:
            watch = InputToVerdict(session)
            time.sleep(25.0)
            watch.restart()
            time.sleep(20.0)
            load = os.getloadavg()[0]
            print(watch.line("input to verdict, demo with six services", 20.0), f" (load {load:.1f})")
            watch.close()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def _written_rules() -> ModuleType:
    spec = importlib.util.spec_from_file_location("written_rules", WRITTEN_RULES)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    """Rules alone, then a real process over Zenoh; with ``--demo`` the whole demo, too."""
    rules()
    over_zenoh()
    if "--demo" in sys.argv:
        in_the_demo()


if __name__ == "__main__":
    main()
