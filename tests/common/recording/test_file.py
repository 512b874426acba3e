"""Recording files: byte for byte, readable by the official reader, whole after a cut, never believed when damaged."""

from __future__ import annotations

import errno
import io
import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from mcap.reader import make_reader

from common.codec import encode
from common.messages import Verdict
from common.recording.file import RecordingFile
from common.recording.reader import (
    WRITTEN_BY,
    RecordingError,
    expected_messages,
    files_in,
    read,
    read_metadata,
    span_ns,
    summarise,
)

KEY = "jetson0/fusion/verdict"
Make = Callable[..., Verdict]
Recorded = Callable[..., Path]
Limit = Callable[[int], AbstractContextManager[None]]


def test_messages_come_back_byte_for_byte(recording_of: Recorded, verdict: Make) -> None:
    path = recording_of(100)
    recorded = list(read(path))
    assert [one.log_ns for one in recorded] == list(range(1000, 1100))
    assert recorded[7].payload == encode(verdict(1007, 7))
    summary = summarise(path)
    assert (summary.counts, summary.complete, summary.start_ns, summary.end_ns) == ({KEY: 100}, True, 1000, 1099)


def test_the_official_reader_agrees_with_index_and_statistics(recording_of: Recorded) -> None:
    path = recording_of(50, flush_every=10)
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


@pytest.mark.parametrize("note", ["", "x" * 300_000], ids=["little to say", "much to say"])
def test_a_file_that_cannot_be_begun_is_not_left_behind(tmp_path: Path, file_size_limit: Limit, note: str) -> None:
    with file_size_limit(10), pytest.raises(OSError, match="File too large"):
        RecordingFile(tmp_path / "a.mcap", {"spotter": {"note": note}}).close()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_to_be_whole_is_not_left_behind_when_its_writing_is_ended(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), RecordingFile(tmp_path / "a.mcap", {}, whole=True):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_cut_file_is_read_up_to_its_last_whole_chunk(recording_of: Recorded) -> None:
    path = recording_of(30, flush_every=1)
    whole = path.read_bytes()
    chunks = make_reader(io.BytesIO(whole)).get_summary().chunk_indexes
    for number in (1, len(chunks) // 2, len(chunks) - 1):
        path.write_bytes(whole[: chunks[number].chunk_start_offset + chunks[number].chunk_length // 2])
        stamps = [one.log_ns for one in read(path)]
        assert 0 < len(stamps) < 30
        assert stamps == list(range(1000, 1000 + len(stamps)))
        assert not summarise(path).complete


def test_damage_is_found_or_harmless_but_never_believed(recording_of: Recorded) -> None:
    """A flipped byte anywhere: the same messages as before, fewer of them, or a clear error; never other ones."""
    path = recording_of(30)
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


def test_the_index_tells_what_there_is_before_anything_is_read(recording_of: Recorded) -> None:
    path = recording_of(40)
    assert (expected_messages(path), span_ns(path)) == (40, (1000, 1039))
    assert read_metadata(path) == {"spotter": {"version": "x"}}
    path.write_bytes(path.read_bytes()[:-100])  # the recorder was killed
    assert (expected_messages(path), span_ns(path), read_metadata(path)) == (0, (0, 0), {})


def test_a_folder_is_its_files_in_order(tmp_path: Path) -> None:
    for name in ("spotter-1-001.mcap", "spotter-1-000.mcap", "notes.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in files_in(tmp_path)] == ["spotter-1-000.mcap", "spotter-1-001.mcap"]
    assert files_in(tmp_path / "notes.txt") == [tmp_path / "notes.txt"]


def test_files_of_one_recorder_go_by_its_own_count_also_where_the_clock_was_set_back(tmp_path: Path) -> None:
    written = [
        ("spotter-20260314T120000Z-000.mcap", "b", 0),
        ("spotter-20260314T120500Z-001.mcap", "b", 1),
        ("spotter-20260314T100000Z-002.mcap", "b", 2),  # the clock was set back by two hours
        ("spotter-20260314T110000Z-000.mcap", "a", 0),  # of another recorder, before
    ]
    for name, recorder, number in written:
        with RecordingFile(tmp_path / name, {WRITTEN_BY: {"recorder": recorder, "file": str(number)}}):
            pass
    RecordingFile(tmp_path / "spotter-20260314T113000Z-000.mcap", {}).close()  # of an older version
    (tmp_path / "spotter-20260314T130000Z-000.mcap").write_bytes(b"damaged")
    whole = tmp_path / written[1][0]
    whole.write_bytes(whole.read_bytes()[:200])  # its recorder was killed
    hours = [path.name.split("T")[1][:4] for path in files_in(tmp_path)]
    assert hours == ["1100", "1130", "1200", "1205", "1000", "1300"]


def test_what_cannot_be_read_at_all_is_told_as_such(tmp_path: Path) -> None:
    for path, why in ((tmp_path, "Is a directory"), (Path("/proc/self/mem"), "Input/output error")):
        for look in (summarise, expected_messages, span_ns, read_metadata):
            with pytest.raises(RecordingError, match=f"^{path}: cannot be read: {why}$"):
                look(path)


def test_a_cut_file_on_a_disk_that_fails_is_not_taken_for_its_end(
    recording_of: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recording_of(40, flush_every=10)
    path.write_bytes(path.read_bytes()[:-100])

    def fail(_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("mcap.stream_reader.Chunk.read", fail)
    with pytest.raises(RecordingError, match="cannot be read: Input/output error"):
        list(read(path))


def test_a_clock_that_was_set_back_while_recording_does_not_mix_before_and_after(
    tmp_path: Path, verdict: Make, add: Callable[..., None]
) -> None:
    path = tmp_path / "a.mcap"
    with RecordingFile(path, {}) as file:
        for i in range(40):
            add(file, KEY, verdict(1000 + i, i), 1000 + 10 * i - (155 if i >= 20 else 0))
            if not i % 7:
                file.flush()
    in_order = [encode(verdict(1000 + i, i)) for i in range(40)]
    assert [one.payload for one in read(path)] == in_order
    path.write_bytes(path.read_bytes()[:-100])  # the same as of a recorder that was killed
    assert [one.payload for one in read(path)] == in_order
