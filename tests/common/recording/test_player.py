"""Playing a recording back: in order, at any pace, under its own namespace."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from common.bus.session import open_session
from common.codec import decode
from common.config import ZenohConfig
from common.messages import EgoMotion, LidarZones, Message
from common.recording.file import RecordingFile
from common.recording.player import Pace, Player

Add = Callable[[RecordingFile, str, Message, int], None]
Until = Callable[[Callable[[], object]], None]
Zones = Callable[[int], LidarZones]


def test_playing_back_keeps_order_spacing_and_namespaces(
    zenoh_config: ZenohConfig, tmp_path: Path, add: Add, zones: Zones, until: Until
) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for i in range(20):
            live_zones = zones(1_000_000 * i)
            live_zones.source_kind = "live"
            add(file, "jetson0/lidar/zones", live_zones, 10**9 + 1_000_000 * i)
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
        put = speaker.declare_publisher("jetson0/lidar/zones")
        until(lambda: put.matching_status.matching)  # the router knows that somebody listens
        player = Player(speaker, [path], Pace(rate=4.0))
        player.run(threading.Event())
        assert done.wait(10)
        tokens = {str(reply.ok.key_expr) for reply in listener.liveliness().get("*/*/alive/*", timeout=2) if reply.ok}
        assert tokens == {"jetson0/lidar/alive/replayed"}
        assert mixed == []
        del subscribers
    stamps = [message.stamp_ns for message in seen]
    assert stamps == sorted(stamps)
    assert {message.source_kind for message in seen} == {"recorded"}  # live when it was recorded
    assert abs(time.time_ns() - stamps[-1]) < 20e9  # the stamps are those of now
    assert stamps[-1] - stamps[0] == pytest.approx(19_000_000 / 4.0, rel=0.01)


def test_seeking_skips_the_beginning(tmp_path: Path, zenoh_config: ZenohConfig, add: Add) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for i in range(10):
            add(file, "jetson0/ego/motion", EgoMotion(stamp_ns=i, speed_mps=None, yaw_rate_radps=None), 10**9 * (1 + i))
    with open_session(zenoh_config) as session:
        player = Player(session, [path], Pace(rate=1e6, seek_s=6.0))
        player.run(threading.Event())
    assert player.played == 4


@pytest.mark.parametrize("set_by_s", [-3600, 120, 86_400])
@pytest.mark.parametrize("files", [1, 2])
def test_what_comes_after_the_clock_was_set_is_played_in_its_time(
    tmp_path: Path, zenoh_config: ZenohConfig, add: Add, files: int, set_by_s: int
) -> None:
    paths = [tmp_path / f"{number}.mcap" for number in range(files)]
    for number, path in enumerate(paths):
        with RecordingFile(path, {}) as file:
            for i in range(20 * number // files, 20 * (number + 1) // files):
                log_ns = 10**13 + i * 10**8 + (set_by_s * 10**9 if i >= 10 else 0)
                add(file, "jetson0/ego/motion", EgoMotion(stamp_ns=log_ns, speed_mps=None, yaw_rate_radps=None), log_ns)
    progress_s: list[float] = []
    with open_session(zenoh_config) as session:
        player = Player(session, paths, Pace(rate=1e6, seek_s=0.35))
        player.run(threading.Event(), progress_s.append)
    assert player.played == 16
    assert progress_s == pytest.approx([0.35 + 0.1 * i for i in range(16)])


def test_a_loop_over_nothing_ends(tmp_path: Path, zenoh_config: ZenohConfig, add: Add) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        add(file, "jetson0/ego/motion", EgoMotion(stamp_ns=1, speed_mps=None, yaw_rate_radps=None), 10**9)
    stop = threading.Event()
    with open_session(zenoh_config) as session:
        player = Player(session, [path], Pace(seek_s=6.0, loop=True))
        thread = threading.Thread(target=player.run, args=(stop,), daemon=True)
        thread.start()
        thread.join(5)
        ended = not thread.is_alive()
        stop.set()
        thread.join()
    assert ended
    assert player.played == 0
