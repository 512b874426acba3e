"""The whole service as a real process over real Zenoh: simulated, recorded, and on a serial port that misbehaves."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import zenoh

from common import topics
from common.bus.session import open_session
from common.codec import decode
from common.config import ZenohConfig
from common.messages import LaserScan, LidarZones, ServiceStatus
from spotter_sim import ld06

pytestmark = pytest.mark.patient
BUDGET_S = 60.0
BACK_S = 2.0  # from the device's return to the first zones: retries are at most 1 s apart, then one whole turn


class Listener:
    """Everything the lidar said, newest last."""

    def __init__(self, session: zenoh.Session) -> None:
        self.zones: list[LidarZones] = []
        self.scans: list[LaserScan] = []
        self.status: list[ServiceStatus] = []
        self._news = threading.Condition()
        self._subscribers = [
            session.declare_subscriber(topic.key("jetson0"), self._keep(topic.message, kept))
            for topic, kept in (
                (topics.LIDAR_ZONES, self.zones),
                (topics.LIDAR_SCAN, self.scans),
                (topics.status_topic("lidar"), self.status),
            )
        ]

    def _keep(self, message_type: type, kept: list) -> Callable[[zenoh.Sample], None]:
        def keep(sample: zenoh.Sample) -> None:
            with self._news:
                kept.append(decode(sample.payload.to_bytes(), message_type))
                self._news.notify_all()

        return keep

    def wait(self, condition: Callable[[], object], budget_s: float = BUDGET_S) -> None:
        with self._news:
            happened = self._news.wait_for(condition, budget_s)
            assert happened, (
                f"did not happen in time; status {[(s.state, s.reason, s.counters) for s in self.status[-3:]]}"
            )

    def says(self, state: str, words: str = "") -> Callable[[], bool]:
        return lambda: bool(self.status) and self.status[-1].state == state and words in self.status[-1].reason


@contextmanager
def lidar(
    zenoh_config: ZenohConfig, source: str, prefix: Sequence[str] = ()
) -> Iterator[tuple[Listener, subprocess.Popen]]:
    command = [*prefix, sys.executable, "-m", "services.jetson.lidar", "--source", source]
    command += ["--set", f'zenoh.connect=["{zenoh_config.connect[0]}"]']
    with open_session(zenoh_config) as session:
        listener = Listener(session)
        process = subprocess.Popen(command)
        try:
            yield listener, process
        finally:
            process.terminate()
            process.wait(10)


class FakeSensor:
    """A serial line with the simulated LD06 at its far end, reachable under a path as a USB adapter would be."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stop = threading.Event()
        self.spoil: Callable[[bytes], bytes] = lambda data: data
        self.says: Callable[[float, float], bytes] = partial(ld06.packets, "empty")  # what it says from when to when

    def plug(self, speed: float = 1.0) -> None:
        self._master, self._slave = os.openpty()
        self._path.symlink_to(os.ttyname(self._slave))
        self._stop = threading.Event()
        self._feeder = threading.Thread(target=self._feed, args=(speed,), daemon=True)
        self._feeder.start()

    def _feed(self, speed: float) -> None:
        began_s, sent_s = time.monotonic(), 0.0
        while not self._stop.wait(0.004):
            due_s = (time.monotonic() - began_s) * speed
            os.write(self._master, self.spoil(self.says(sent_s, due_s)))
            sent_s = due_s

    def unplug(self) -> None:
        """The node disappears and the line is cut, in the middle of a packet."""
        self._stop.set()
        self._feeder.join()
        os.write(self._master, ld06.packets("empty", 0.0, 0.01)[:70])
        self._path.unlink()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def sensor(tmp_path: Path) -> Iterator[FakeSensor]:
    sensor = FakeSensor(tmp_path / "ttyLD06")
    yield sensor
    if (tmp_path / "ttyLD06").is_symlink():
        sensor.unplug()


def test_simulated_world(zenoh_config: ZenohConfig) -> None:
    with lidar(zenoh_config, "sim:crossing?t0=4.0") as (listener, process):
        listener.wait(lambda: any(zones.level == "IMMINENT" for zones in listener.zones))
        listener.wait(listener.says("online"))
        process.terminate()
        assert process.wait(5) == 0
    levels = [zones.level for zones in listener.zones]
    assert levels.index("CAUTION") < levels.index("IMMINENT")
    assert listener.zones[-1].scan_hz > 0.0
    assert listener.scans[-1].used is not None
    assert len(listener.scans[-1].angles_rad) == len(listener.scans[-1].used) == 450
    assert listener.zones[-1].stage_ms["zones"] > 0.0


def test_real_turns_as_recorded_bytes(
    zenoh_config: ZenohConfig, real_turns_m: list[np.ndarray], stream_of: Callable[..., bytes], tmp_path: Path
) -> None:
    turn = np.roll(real_turns_m[0], 1)  # the first line is at 1 degree

    def ranges_at(angle_rad: np.ndarray, _: int) -> np.ndarray:
        return turn[np.round(np.degrees(-angle_rad)).astype(int) % 360]

    recording = tmp_path / "room.ld06"
    recording.write_bytes(stream_of(ranges_at, turns=8))
    with lidar(zenoh_config, f"file:{recording}?rate=2") as (listener, process):
        assert process.wait(BUDGET_S) == 0  # a file ends, and the service with it
    assert len(listener.zones) >= 6
    assert {zones.state for zones in listener.zones} == {"online"}
    degrees = np.arange(-20, 21)
    ahead_m = turn[degrees % 360] * np.cos(np.radians(degrees))
    in_centre = np.abs(turn[degrees % 360] * np.sin(np.radians(degrees))) <= 0.1255
    assert listener.zones[-1].centre.nearest_m == pytest.approx(ahead_m[in_centre].min(), abs=0.01)
    assert listener.zones[-1].level == "IMMINENT"  # 0.79 m


@pytest.mark.slow
def test_serial_port_comes_late_stumbles_and_comes_back(zenoh_config: ZenohConfig, sensor: FakeSensor) -> None:
    with lidar(zenoh_config, f"serial:{sensor._path}") as (listener, _):
        listener.wait(listener.says("disconnected", "does not exist yet"))

        sensor.plug()
        plugged_s = time.monotonic()
        listener.wait(listener.says("online"))
        assert time.monotonic() - plugged_s < BACK_S
        listener.wait(lambda: len(listener.zones) > 5)

        sensor.spoil = lambda data: bytes(byte ^ 0x40 if n == 60 else byte for n, byte in enumerate(data))
        listener.wait(
            lambda: listener.status[-1].counters.get("crc", 0) + listener.status[-1].counters.get("lost_packets", 0)
        )
        assert listener.status[-1].state == "online"

        sensor.spoil = lambda data: bytes(byte ^ 0xFF for byte in data)
        listener.wait(listener.says("disconnected", "no LD06 packet"))
        sensor.spoil = lambda data: b""
        listener.wait(listener.says("disconnected", "silent"))
        sensor.spoil = lambda data: data
        listener.wait(listener.says("online"))

        sensor.unplug()
        listener.wait(listener.says("disconnected", "gone: unplugged?"))
        count = len(listener.zones)
        sensor.plug()
        listener.wait(lambda: len(listener.zones) > count, BACK_S)
        listener.wait(listener.says("online"))
        listener.wait(lambda: len(listener.zones) > count + 3)
        assert listener.zones[count].state == "degraded"
        assert "looking again" in listener.zones[count].reason
        assert listener.zones[-1].state == "online"


def spinning(turns_hz: Callable[[float], float], seconds: float) -> Callable[[float, float], bytes]:
    """What the sensor says while its motor changes speed: 4500 returns a second at any speed, 2 m all round."""
    packets, degrees = [], 0.0
    for number in range(int(seconds * 375)):
        step = 360.0 * turns_hz(number / 375) / 4500
        angles = degrees + step * np.arange(12)
        speed_dps = round(step * 4500)
        packets.append(ld06.encode(angles, np.full(12, 2000), np.full(12, 200), speed_dps, number * 12 / 4.5))
        degrees += 12 * step
    return lambda begin_s, end_s: b"".join(packets[int(begin_s * 375) : int(end_s * 375)])


@pytest.mark.slow
def test_a_motor_that_spins_up_from_standstill_and_stalls(zenoh_config: ZenohConfig, sensor: FakeSensor) -> None:
    """0 turns a second for 3 s, 10 after 5 s, standstill again after 8 s: degraded, online, degraded, each in words."""
    sensor.says = spinning(lambda t: float(np.interp(t, [0, 3, 5, 8, 8.2], [0, 0, 10, 10, 0])), 60.0)
    with lidar(zenoh_config, f"serial:{sensor._path}") as (listener, _):
        listener.wait(listener.says("disconnected", "does not exist yet"))
        sensor.plug()
        listener.wait(listener.says("degraded", "motor slow or stalled"))
        listener.wait(listener.says("online"))
        assert listener.zones[-1].centre.nearest_m == pytest.approx(1.9, abs=0.15)  # counted from the bumper
        listener.wait(listener.says("degraded", "motor slow or stalled"))
        assert listener.status[-1].bad_input == 0


@pytest.mark.slow
def test_a_line_at_half_the_pace_still_gives_zones(zenoh_config: ZenohConfig, sensor: FakeSensor) -> None:
    """The sensor's clock runs away from ours; it is laid anew and counted, and nothing is called lost."""
    with lidar(zenoh_config, f"serial:{sensor._path}") as (listener, _):
        listener.wait(listener.says("disconnected", "does not exist yet"))
        sensor.plug(speed=0.5)
        listener.wait(lambda: len(listener.zones) > 15)
        listener.wait(lambda: listener.status[-1].counters.get("clock_restarts"))
        assert listener.status[-1].state == "online"
        assert listener.status[-1].bad_input == 0


@pytest.mark.slow
def test_each_way_of_not_opening_has_its_own_words(
    zenoh_config: ZenohConfig, sensor: FakeSensor, tmp_path: Path
) -> None:
    plain_file = tmp_path / "notes.txt"
    plain_file.write_text("not a port")
    with lidar(zenoh_config, f"serial:{plain_file}") as (listener, _):
        listener.wait(listener.says("disconnected", "no serial port"))

    sensor.plug()
    with lidar(zenoh_config, f"serial:{sensor._path}") as (first, _):
        first.wait(first.says("online"))
        with lidar(zenoh_config, f"serial:{sensor._path}") as (second, _):
            second.wait(second.says("disconnected", "in use by another process"))


@pytest.mark.slow
def test_wrong_permissions_have_their_own_words(zenoh_config: ZenohConfig, tmp_path: Path) -> None:
    port = tmp_path / "ttyLD06"
    port.touch(mode=0o000)
    as_user: list[str] = []
    if os.geteuid() == 0:  # root without the right to override permissions is like any user to its own files
        if shutil.which("setpriv") is None:
            pytest.skip("running as root, and setpriv (util-linux) is not here to give up the right to read everything")
        as_user = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
    with lidar(zenoh_config, f"serial:{port}", as_user) as (listener, _):
        listener.wait(listener.says("disconnected", "permission denied"))
