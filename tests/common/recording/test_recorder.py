"""The recorder on a real bus: everything is in the file, what is missing is counted, a kill costs little."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from datetime import UTC, datetime, tzinfo
from pathlib import Path

import pytest
from mcap.reader import make_reader

from common import topics
from common.bus.runtime import Service
from common.bus.session import open_session
from common.codec import decode, encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import LidarZones
from common.recording.file import RecordingFile
from common.recording.reader import files_in, read, summarise
from common.recording.recorder import Arrival, DiskFull, Recorder, RecorderOptions

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
        until(lambda: publish.has_subscribers)

        run_recorder(recorder, lambda: [publish(zones(i)) for i in range(200)] and None, 200)
    assert (recorder.status.messages, recorder.status.dropped) == (200, 0)
    (path,) = tmp_path.glob("*.mcap")
    refused: Counter[str] = Counter()
    assert [decode(one.payload, LidarZones).stamp_ns for one in read(path, refused=refused)] == list(range(200))
    assert not refused  # what the recorder itself writes is no damaged message
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
        until(lambda: publish.has_subscribers)
        enough = threading.Event()

        def feed() -> None:
            for i in range(400):
                publish(zones(i))
                if len(list(tmp_path.glob("*.mcap"))) >= 2 and i > 50:
                    break
                enough.wait(0.01)

        run_recorder(recorder, feed, 52)
    files_in(tmp_path)[-1].rename(tmp_path / "spotter-19700101T000000Z-000.mcap")  # as if the clock had been set back
    paths = files_in(tmp_path)
    assert len(paths) >= 2
    assert paths[-1].name == "spotter-19700101T000000Z-000.mcap"
    stamps = [decode(one.payload, LidarZones).stamp_ns for path in paths for one in read(path)]
    assert stamps == list(range(len(stamps)))


def test_a_full_disk_stops_before_it_is_full(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones, run_recorder: Run, until: Until
) -> None:
    with open_session(zenoh_config) as laptop:
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, keep_free_bytes=10**18), {})
        with pytest.raises(DiskFull, match="GB free"):
            recorder.run(threading.Event())


def test_a_disk_that_takes_no_file_at_all_leaves_none_behind(
    zenoh_config: ZenohConfig, tmp_path: Path, file_size_limit: Callable[[int], AbstractContextManager[None]]
) -> None:
    message = (
        f"{re.escape(str(tmp_path))}.*: File too large; recording stopped before the first message, no file is left"
    )
    with open_session(zenoh_config) as laptop:
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, 0, foxglove=False), {})
        with file_size_limit(10), pytest.raises(DiskFull, match=message):
            recorder.run(threading.Event())
        recorder.close()
    assert list(tmp_path.iterdir()) == []


def test_recorders_that_begin_in_one_folder_in_the_same_second_have_a_file_each(
    zenoh_config: ZenohConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Second(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Second:
            return cls(2026, 3, 14, 9, 15, 2, tzinfo=tz)

    monkeypatch.setattr("common.recording.recorder.datetime", Second)
    with open_session(zenoh_config) as laptop:
        for _ in range(2):
            recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, 0, foxglove=False), {})
            stop = threading.Event()
            recorder.run(stop, lambda _, stop=stop: stop.set())  # type: ignore[misc]
            recorder.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "spotter-20260314T091502Z-000.mcap",
        "spotter-20260314T091502Z-001.mcap",
    ]


@pytest.fixture
def room_for() -> Iterator[Callable[[int], None]]:
    """``room_for(size)``: from now on no file of this process grows beyond that many bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_takes_no_more_is_one_line_and_the_file_holds_until_then(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones, room_for: Callable[[int], None], until: Until
) -> None:
    with (
        open_session(zenoh_config) as laptop,
        Service("lidar", ServiceConfig(host="jetson0", zenoh=zenoh_config)) as lidar,
    ):
        publish = lidar.publisher(topics.LIDAR_ZONES)
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, 0, foxglove=False), {})
        until(lambda: publish.has_subscribers)
        errors: list[str] = []

        def run() -> None:
            try:
                recorder.run(threading.Event())
            except DiskFull as error:
                errors.append(str(error))

        thread = threading.Thread(target=run)
        thread.start()
        publish(zones(0))
        until(lambda: recorder.status.free_bytes)  # the first second is on the disk
        room_for(20_000)
        until(lambda: publish(zones(time.time_ns())) or errors)
        thread.join()
        recorder.close()
    (path,) = tmp_path.glob("*.mcap")
    said = re.fullmatch(
        f"{re.escape(str(path))}: File too large; recording stopped, the file holds everything up to (.*) UTC",
        errors[0],
    )
    assert said is not None
    last_s = [one.log_ns for one in read(path)][-1] // 1_000_000_000
    held_s = datetime.strptime(said[1], "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
    assert last_s - 2 <= held_s <= last_s  # the promise is what was flushed; a part of the next second may be there too


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
        until(lambda: any(path.stat().st_size > 20_000 for path in tmp_path.glob("*.mcap")), budget_s=30)
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


def test_a_bus_that_is_faster_than_the_disk_does_not_keep_the_recorder_from_flushing_or_ending(
    zenoh_config: ZenohConfig, tmp_path: Path, zones: Zones
) -> None:
    class Overrun(Recorder):
        def _write(self, file: RecordingFile, arrival: Arrival) -> None:
            super()._write(file, arrival)
            self._queue.put(arrival)  # another one is there before this one is done

    stop, reported = threading.Event(), threading.Event()
    with open_session(zenoh_config) as laptop:
        recorder = Overrun(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, 0, foxglove=False), {})
        recorder._queue.put(Arrival("jetson0/lidar/zones", encode(zones(1)), 1))
        thread = threading.Thread(target=recorder.run, args=(stop, lambda _: reported.set()), daemon=True)
        thread.start()
        assert reported.wait(20)
        stop.set()
        thread.join(20)
        recorder.close()
    assert not thread.is_alive()
