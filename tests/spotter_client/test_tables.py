"""Streams and recordings as tables, with the real libraries; and the sentence where one is missing."""

from __future__ import annotations

import datetime as dt
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.codec import encode
from common.messages import Message, RadarTrack, RadarTracks, Verdict, VerdictInput
from common.recording.file import RecordingFile
from common.recording.reader import RecordingError
from spotter_client import open_recording
from spotter_client.stream import Stream

START_NS = 1_700_000_000_123_456_789


def radar(stamp_ns: int, count: int) -> RadarTracks:
    tracks = [
        RadarTrack(
            track_id=i, range_m=4.0 + i, azimuth_rad=None, velocity_mps=-1.5, age_frames=12, approaching=True,
            moving=True, ttc_s=2.8, level="CAUTION", snr_db=18.0,
        )
        for i in range(count)
    ]  # fmt: skip
    return RadarTracks(stamp_ns=stamp_ns, tracks=tracks, level="CAUTION", settled=True, noise_floor_db=-60.0)


def verdict(stamp_ns: int, age_ms: float | None) -> Verdict:
    used = VerdictInput(state="online", level="SAFE", age_ms=age_ms, used=True, why="")
    return Verdict(
        stamp_ns=stamp_ns, level="SAFE", rule="R0-clear", because="clear", inputs={"lidar": used}, confirmed=False,
        suppressed=False, advisory=None, blind=False, permission="GO",
    )  # fmt: skip


def messages() -> Iterator[tuple[str, Message]]:
    for turn in range(3):
        stamp_ns = START_NS + turn * 100_000_000
        yield "pi0/radar/tracks", radar(stamp_ns, turn)
        yield "jetson0/fusion/verdict", verdict(stamp_ns, None if turn == 0 else 12.5)


def of(key: str) -> Stream[Message]:
    return Stream((at, message) for at, message in messages() if at == key)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "drive.mcap"
    with RecordingFile(path, {}) as file:
        for key, message in messages():
            file.add(key, type(message), encode(message), message.stamp_ns, message.sent_ns, message.seq)
        file.add("pi0/radar/tracks", RadarTracks, b"nonsense", START_NS, START_NS, 9)
    return path


def test_a_row_a_message_in_pandas() -> None:
    pytest.importorskip("pandas")
    table = of("jetson0/fusion/verdict").to_pandas()
    assert list(table["inputs.lidar.age_ms"].astype(object).where(table["inputs.lidar.age_ms"].notna(), None)) == [
        None,
        12.5,
        12.5,
    ]
    assert list(table["stamp_ns"]) == [START_NS + turn * 100_000_000 for turn in range(3)]
    assert table["time"][0].value == START_NS  # to the nanosecond
    assert table["time"][0].tzinfo is not None
    assert set(table["key"]) == {"jetson0/fusion/verdict"}


def test_a_row_a_track_in_both() -> None:
    for library in ("pandas", "polars"):
        pytest.importorskip(library)
        table = getattr(of("pi0/radar/tracks"), f"to_{library}")(each="tracks")
        assert len(table) == 3  # 0 + 1 + 2
        assert list(table["tracks.range_m"]) == [4.0, 4.0, 5.0]
        assert list(table["level"]) == ["CAUTION"] * 3


def test_times_of_polars_are_utc() -> None:
    pytest.importorskip("polars")
    first = of("pi0/radar/tracks").to_polars()["time"][0]
    assert first == dt.datetime.fromtimestamp(START_NS // 1000 / 1e6, dt.UTC)


def test_nothing_is_an_empty_table() -> None:
    for library in ("pandas", "polars"):
        pytest.importorskip(library)
        assert len(getattr(of("nobody"), f"to_{library}")()) == 0


def test_a_list_that_is_not_there_is_told_with_those_that_are() -> None:
    pytest.importorskip("pandas")
    with pytest.raises(KeyError, match="no list 'zones'; it has tracks"):
        of("pi0/radar/tracks").to_pandas(each="zones")


def test_a_library_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(ImportError, match="needs polars, which is not installed: pip install polars"):
        of("pi0/radar/tracks").to_polars()


def test_a_recording_is_streams(recording: Path) -> None:
    one = open_recording(recording)
    assert [len(message.tracks) for message in one.stream("*/radar/tracks", RadarTracks)] == [0, 1, 2]
    assert one.refused == {"pi0/radar/tracks": 1}
    assert len(list(open_recording(recording.parent).stream())) == 6  # a folder
    with pytest.raises(TypeError, match="expected Verdict, this key carries RadarTracks"):
        list(one.stream("pi0/radar/tracks", Verdict))


def test_what_is_no_recording_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such recording"):
        open_recording(tmp_path / "nothing.mcap")
    (tmp_path / "x.mcap").write_bytes(b"hello")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        list(open_recording(tmp_path / "x.mcap").stream())
