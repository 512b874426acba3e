"""Recordings: written as they came, readable by the official reader, whole after a kill, honest about what was lost."""

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
from common.codec import decode, encode, to_builtins
from common.config import ServiceConfig, ZenohConfig
from common.messages import EgoMotion, LidarZone, LidarZones, Message, Verdict
from common.recording.file import RecordingFile
from common.recording.player import Pace, Player
from common.recording.reader import RecordingError, read, summarise
from common.recording.recorder import DiskFull, Recorder, RecorderOptions
from common.runtime import Service
from common.session import open_session

KEY = "jetson0/fusion/verdict"


def verdict(stamp_ns: int, seq: int = 0) -> Verdict:
    return Verdict(
        stamp_ns=stamp_ns, seq=seq, level="CAUTION", rule="R1", because="test", inputs={}, confirmed=False,
        suppressed=False, advisory=None, blind=False, permission="SLOW",
    )  # fmt: skip


def add(file: RecordingFile, key: str, message: Message, log_ns: int) -> None:
    file.add(key, type(message), encode(message), log_ns, message.sent_ns, message.seq)


def test_messages_come_back_byte_for_byte(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {"spotter": {"version": "x"}}) as file:
        for i in range(100):
            add(file, KEY, verdict(1000 + i, i), 1000 + i)
    recorded = list(read(path))
    assert [one.log_ns for one in recorded] == list(range(1000, 1100))
    assert recorded[7].payload == encode(verdict(1007, 7))
    summary = summarise(path)
    assert (summary.counts, summary.complete, summary.start_ns, summary.end_ns) == ({KEY: 100}, True, 1000, 1099)


def test_the_official_reader_agrees_with_index_and_statistics(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {"spotter": {"version": "x"}}) as file:
        for i in range(50):
            add(file, KEY, verdict(1000 + i, i), 1000 + i)
            if i % 10 == 0:
                file.flush()
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 50 == sum(summary.statistics.channel_message_counts.values())
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 3
        (schema,) = summary.schemas.values()
        assert schema.name == "spotter.Verdict.v1"
        assert "permission" in json.loads(schema.data)["$defs"]["Verdict"]["properties"]
        assert len(list(reader.iter_messages(starting_at=1040))) == 10


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        RecordingFile(path, {})
    assert path.read_bytes() == b"precious"


def test_a_cut_file_is_read_up_to_its_last_whole_chunk(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for i in range(30):
            add(file, KEY, verdict(1000 + i, i), 1000 + i)
            file.flush()
    whole = path.read_bytes()
    for cut in (1500, 4000, 8000):
        path.write_bytes(whole[:cut])
        stamps = [one.log_ns for one in read(path)]
        assert 0 < len(stamps) < 30
        assert stamps == list(range(1000, 1000 + len(stamps)))
        assert not summarise(path).complete


def test_damage_is_found_or_harmless_but_never_believed(tmp_path: Path) -> None:
    """A flipped byte anywhere: the same messages as before, fewer of them, or a clear error; never other ones."""
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for i in range(30):
            add(file, KEY, verdict(1000 + i, i), 1000 + i)
    whole = path.read_bytes()
    true = {one.payload for one in read(path)}
    refused = 0
    for position in range(0, len(whole), 7):
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        path.write_bytes(bytes(damaged))
        try:
            assert {one.payload for one in read(path)} <= true, position
        except RecordingError:
            refused += 1
    assert refused > 20


@pytest.mark.parametrize("content", [b"", b"not a recording at all, but long enough to be looked at"])
def test_something_else_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError):
        summarise(path)


def zones(stamp_ns: int) -> LidarZones:
    zone = LidarZone(nearest_m=None, points=0, level="SAFE")
    return LidarZones(stamp_ns=stamp_ns, left=zone, centre=zone, right=zone, level="SAFE", raw_level="SAFE")


def run_recorder(recorder: Recorder, feed: Callable[[], None], expect: int) -> None:
    """Feed while recording and stop when everything has been written."""
    stop = threading.Event()
    failures: list[DiskFull] = []

    def record() -> None:
        try:
            recorder.run(stop)
        except DiskFull as error:
            failures.append(error)

    thread = threading.Thread(target=record)
    thread.start()
    feed()
    deadline_s = time.monotonic() + 20
    while recorder.status.messages < expect and time.monotonic() < deadline_s and not failures:
        stop.wait(0.01)
    stop.set()
    thread.join(20)
    if failures:
        raise failures[0]


def test_a_live_recording_holds_everything_and_says_so(zenoh_config: ZenohConfig, tmp_path: Path) -> None:
    with (
        open_session(zenoh_config) as laptop,
        Service("lidar", ServiceConfig(host="jetson0", zenoh=zenoh_config)) as lidar,
    ):
        publish = lidar.publisher(topics.LIDAR_ZONES)
        options = RecorderOptions(tmp_path, keep_free_bytes=0)
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], options, {})
        while not publish.heard:
            time.sleep(0)  # yield to Zenoh's threads

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


def test_missing_messages_are_counted_in_the_file(zenoh_config: ZenohConfig, tmp_path: Path) -> None:
    with open_session(zenoh_config) as laptop, open_session(zenoh_config) as publisher:
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, keep_free_bytes=0), {})
        put = publisher.declare_publisher("jetson0/lidar/zones")
        while not put.matching_status.matching:
            time.sleep(0)

        def feed() -> None:
            for seq in (0, 1, 2, 7, 8):  # 3 to 6 never came
                message = zones(seq)
                message.seq = seq
                put.put(encode(message))

        run_recorder(recorder, feed, 5)
    assert recorder.status.dropped == 4


def test_files_rotate_by_size_and_none_is_lost_at_the_seam(zenoh_config: ZenohConfig, tmp_path: Path) -> None:
    with (
        open_session(zenoh_config) as laptop,
        Service("lidar", ServiceConfig(host="jetson0", zenoh=zenoh_config)) as lidar,
    ):
        publish = lidar.publisher(topics.LIDAR_ZONES)
        options = RecorderOptions(tmp_path, keep_free_bytes=0, rotate_bytes=1)
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], options, {})
        while not publish.heard:
            time.sleep(0)
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


def test_a_full_disk_stops_before_it_is_full(zenoh_config: ZenohConfig, tmp_path: Path) -> None:
    with open_session(zenoh_config) as laptop:
        recorder = Recorder(laptop, [topics.LIDAR_ZONES], RecorderOptions(tmp_path, keep_free_bytes=10**18), {})
        with pytest.raises(DiskFull, match="GB free"):
            recorder.run(threading.Event())


@pytest.mark.system
def test_a_killed_recorder_loses_less_than_a_second(zenoh_config: ZenohConfig, tmp_path: Path) -> None:
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
    assert killed_ns - summary.end_ns < 1_500_000_000


def test_playing_back_keeps_order_spacing_and_namespaces(zenoh_config: ZenohConfig, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for i in range(20):
            add(file, "jetson0/lidar/zones", zones(1_000_000 * i), 10**9 + 1_000_000 * i)
    replayed = ZenohConfig(connect=zenoh_config.connect, namespace="replay")
    with open_session(zenoh_config) as live, open_session(replayed) as listener, open_session(replayed) as speaker:
        seen: list[LidarZones] = []
        mixed: list[object] = []
        done = threading.Event()

        def note(sample: object) -> None:
            seen.append(decode(sample.payload.to_bytes(), LidarZones))  # type: ignore[attr-defined]
            if len(seen) == 20:
                done.set()

        subscribers = [
            listener.declare_subscriber("jetson0/lidar/zones", note),
            live.declare_subscriber("**", mixed.append),
        ]
        player = Player(speaker, [path], Pace(rate=4.0))
        player.run(threading.Event())
        assert done.wait(10)
        tokens = {str(reply.ok.key_expr) for reply in listener.liveliness().get("*/*/alive/*", timeout=2) if reply.ok}
        assert tokens == {"jetson0/lidar/alive/replayed"}
        assert mixed == []
        del subscribers
    stamps = [message.stamp_ns for message in seen]
    assert stamps == sorted(stamps)
    assert abs(time.time_ns() - stamps[-1]) < 20e9  # the stamps are those of now
    assert stamps[-1] - stamps[0] == pytest.approx(19_000_000 / 4.0, rel=0.01)


def test_seeking_skips_the_beginning(tmp_path: Path, zenoh_config: ZenohConfig) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for i in range(10):
            add(file, "jetson0/ego/motion", EgoMotion(stamp_ns=i, speed_mps=None, yaw_rate_radps=None), 10**9 * (1 + i))
    with open_session(zenoh_config) as session:
        player = Player(session, [path], Pace(rate=1e6, seek_s=6.0))
        player.run(threading.Event())
    assert player.played == 4


def test_converted_scenes_are_foxgloves_own() -> None:
    foxglove = pytest.importorskip("common.recording.foxglove")
    ((name, log),) = foxglove.convert(KEY, verdict(10**18))
    assert name == "/foxglove/jetson0/fusion/verdict"
    assert type(log).get_schema().name == "foxglove.Log"
    assert "test" in to_builtins(verdict(1))["because"]
