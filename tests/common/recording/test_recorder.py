"""The recorder on a real bus: everything is in the file, what is missing is counted, a kill costs little."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from common import topics
from common.codec import decode, encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import LidarZones
from common.recording.reader import read, summarise
from common.recording.recorder import DiskFull, Recorder, RecorderOptions
from common.runtime import Service
from common.session import open_session

Zones = Callable[[int], LidarZones]
Run = Callable[[Recorder, Callable[[], object], int], None]
Until = Callable[[Callable[[], object]], None]


def test_a_live_recording_holds_everything_and_says_so(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones, run_recorder: Run, until: Until
) -> None:
    with (
        open_session(zenoh_config) as laptop,
        Service("lidar", ServiceConfig(host="jetson0", zenoh=zenoh_config)) as lidar,
    ):
        publish = lidar.publisher(topics.LIDAR_ZONES)
        options = RecorderOptions(tmp_path, keep_free_bytes=0)
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], options, {})
        until(lambda: publish.heard)

        run_recorder(recorder, lambda: [publish(zones(i)) for i in range(200)] and None, 200)
    assert (recorder.status.messages, recorder.status.dropped) == (200, 0)
    (path,) = tmp_path.glob("*.mcap")
    assert [decode(one.payload, LidarZones).stamp_ns for one in read(path)] == list(range(200))
    with path.open("rb") as stream:
        status = [
            json.loads(m.data) for _, c, m in make_reader(stream).iter_messages() if c.topic == "/recorder/status"
        ]
    assert status[-1]["messages"] == 200
    assert status[-1]["dropped"] == 0


def test_missing_messages_are_counted_in_the_file(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones, run_recorder: Run, until: Until
) -> None:
    with open_session(zenoh_config) as laptop, open_session(zenoh_config) as publisher:
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, keep_free_bytes=0), {})
        put = publisher.declare_publisher("jetson0/lidar/zones")
        until(lambda: put.matching_status.matching)

        def feed() -> None:
            for seq in (0, 1, 2, 7, 8):  # 3 to 6 never came
                message = zones(seq)
                message.seq = seq
                put.put(encode(message))

        run_recorder(recorder, feed, 5)
    assert recorder.status.dropped == 4


def test_files_rotate_by_size_and_none_is_lost_at_the_seam(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones, run_recorder: Run, until: Until
) -> None:
    with (
        open_session(zenoh_config) as laptop,
        Service("lidar", ServiceConfig(host="jetson0", zenoh=zenoh_config)) as lidar,
    ):
        publish = lidar.publisher(topics.LIDAR_ZONES)
        options = RecorderOptions(tmp_path, keep_free_bytes=0, rotate_bytes=1)
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], options, {})
        until(lambda: publish.heard)
        enough = threading.Event()

        def feed() -> None:
            for i in range(400):
                publish(zones(i))
                if len(list(tmp_path.glob("*.mcap"))) >= 2 and i > 50:
                    break
                enough.wait(0.01)

        run_recorder(recorder, feed, 52)
    paths = sorted(tmp_path.glob("*.mcap"), key=lambda path: path.stem[-3:])
    assert len(paths) >= 2
    stamps = [decode(one.payload, LidarZones).stamp_ns for path in paths for one in read(path)]
    assert stamps == list(range(len(stamps)))


def test_a_full_disk_stops_before_it_is_full(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones, run_recorder: Run, until: Until
) -> None:
    with open_session(zenoh_config) as laptop:
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, keep_free_bytes=10**18), {})
        with pytest.raises(DiskFull, match="GB free"):
            recorder.run(threading.Event())


@pytest.mark.system
def test_a_killed_recorder_loses_less_than_a_second(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones, run_recorder: Run, until: Until
) -> None:
    stop = threading.Event()
    config = ServiceConfig(host="jetson0", zenoh=zenoh_config)

    def speak() -> None:
        with Service("lidar", config) as lidar:
            publish = lidar.publisher(topics.LIDAR_ZONES)
            while not stop.wait(0.01):
                publish(zones(time.time_ns()))

    speaker = threading.Thread(target=speak)
    speaker.start()
    script = str(Path(sys.executable).with_name("spotter"))
    process = subprocess.Popen(
        [script, "record", str(tmp_path), "--connect", zenoh_config.connect[0], "--keep-free", "0"],
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline_s = time.monotonic() + 30
        while not any(path.stat().st_size > 20_000 for path in tmp_path.glob("*.mcap")):
            assert time.monotonic() < deadline_s
        killed_ns = time.time_ns()
        os.kill(process.pid, signal.SIGKILL)
        process.wait(10)
    finally:
        stop.set()
        speaker.join()
    (path,) = tmp_path.glob("*.mcap")
    summary = summarise(path)
    assert not summary.complete
    assert killed_ns - summary.end_ns < 1_000_000_000
