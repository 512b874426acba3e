"""Tables out of recordings: every row there, every column of its own type, nothing overwritten by accident."""

from __future__ import annotations

import csv
import io
import json
import sys
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from typer.testing import CliRunner

from spotter_tools.cli.__main__ import app
from spotter_tools.cli.export_tables import COLUMNS, HEADER, columns

runner = CliRunner()


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_one_row_per_verdict_track_and_zone(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "all.csv"
    result = runner.invoke(app, ["export", str(recording), str(out), "--json"])
    assert result.exit_code == 0, result.output
    expected = {"verdicts": 60, "radar": 60, "objects": 60, "zones": 180, "camera": 60}
    assert json.loads(result.stdout) == {"file": str(out), "rows": expected}
    rows = table(out)
    assert Counter(row["table"] for row in rows) == expected
    assert list(rows[0]) == columns(tuple(COLUMNS))


def test_the_values_are_those_of_the_messages(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "all.csv"
    runner.invoke(app, ["export", str(recording), str(out)])
    first = {name: next(row for row in table(out) if row["table"] == name) for name in COLUMNS}
    assert first["verdicts"]["because"] == "lidar SAFE at 0.61 m"
    assert (first["verdicts"]["lidar_state"], first["verdicts"]["lidar_age_ms"]) == ("online", "12.5")
    assert first["verdicts"]["radar_state"] == ""
    assert float(first["radar"]["range_m"]) == 9.0
    assert float(first["objects"]["speed_mps"]) == pytest.approx(5.0)
    assert (first["camera"]["label"], first["camera"]["bottom_px"]) == ("person", "90.0")
    nearest = {row["zone"]: row["nearest_m"] for row in table(out) if row["table"] == "zones"}
    assert nearest == {"left": "", "centre": "0.61", "right": ""}
    times_s = [float(row["time_s"]) for row in table(out)]
    assert (min(times_s), max(times_s)) == (0.0, 5.9)


def test_one_table_has_only_its_own_columns(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "radar.csv"
    runner.invoke(app, ["export", str(recording), str(out), "--table", "radar"])
    assert list(table(out)[0]) == [*HEADER, *COLUMNS["radar"]]


@pytest.mark.parametrize(
    ("arguments", "error_text"),
    [
        (["missing.mcap", "out.csv"], "no such file"),
        (["IT", "out.xlsx"], "ends with .csv, .parquet or .geojson, or --as csv"),
        (["IT", "out.csv", "--table", "tracks"], "no such table; known: verdicts"),
        (["IT", "taken.csv"], "--force"),
    ],
)
def test_what_cannot_be_done_is_said(
    recording: Path, tmp_path: Path, arguments: list[str], error_text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken.csv").write_text("precious")
    result = runner.invoke(app, ["export", *(str(recording) if text == "IT" else text for text in arguments)])
    assert result.exit_code == 2
    assert error_text in result.output
    assert (tmp_path / "taken.csv").read_text() == "precious"


def test_a_recording_is_not_replaced_by_its_own_export(recording: Path, tmp_path: Path) -> None:
    whole = recording.read_bytes()
    link = tmp_path / "link.mcap"
    link.symlink_to(recording)
    for out in (recording, link):
        result = runner.invoke(app, ["export", str(recording), str(out), "--as", "csv", "--force"])
        assert (result.exit_code, result.output) == (2, f"spotter: {out}: is the recording itself; give another name\n")
    assert recording.read_bytes() == whole


def test_a_recording_that_was_cut_off_is_named(recording: Path, tmp_path: Path) -> None:
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.csv"
    cut.write_bytes(recording.read_bytes()[:-200])
    result = runner.invoke(app, ["export", str(cut), str(out)])
    assert f"{cut} has no end: cut off, or still written" in result.stderr
    assert result.exit_code == 0, result.output
    assert "has no end" not in runner.invoke(app, ["export", str(recording), str(out), "--force"]).stderr


def test_a_damaged_recording_is_refused(recording: Path, tmp_path: Path) -> None:
    damaged = bytearray(recording.read_bytes())
    chunk = make_reader(io.BytesIO(damaged)).get_summary().chunk_indexes[0]
    damaged[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(bytes(damaged))
    result = runner.invoke(app, ["export", str(path), str(tmp_path / "out.csv")])
    assert result.exit_code == 1
    assert "damaged" in result.output
    assert [one.name for one in tmp_path.iterdir()] == ["damaged.mcap"]  # no half a table either


def made_of(path: Path, channels: list[tuple[str, str, str, bytes]]) -> Path:
    """A recording of one message for each (key, schema, message encoding, payload)."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for key, schema, encoding, payload in channels:
            number = writer.register_schema(schema, "jsonschema", b"{}")
            writer.add_message(writer.register_channel(key, encoding, number), 1, payload, 1)
        writer.finish()
    return path


GARBAGE = ("pi0/radar/tracks", "spotter.RadarTracks", "msgpack", b"\xc1garbage")
LYING_NAME = ("jetson0/lidar/zones", "spotter.Verdict", "msgpack", b"\x80")
LYING_ENCODING = ("jetson0/lidar/zones", "spotter.LidarZones", "json", b"{}")
FOREIGN = ("jetson0/fusion/verdict", "other.Verdict", "msgpack", b"\x80")


@pytest.mark.parametrize("wrong", [GARBAGE, LYING_NAME, LYING_ENCODING, FOREIGN], ids=lambda wrong: wrong[1])
def test_what_cannot_be_read_is_counted_and_an_error(tmp_path: Path, wrong: tuple[str, str, str, bytes]) -> None:
    path = made_of(tmp_path / "wrong.mcap", [wrong, wrong])
    result = runner.invoke(app, ["export", str(path), str(tmp_path / "out.csv")])
    assert result.exit_code == 1
    assert f"2 messages could not be read and were left out: 2 of {wrong[0]}" in result.output
    verified = runner.invoke(app, ["replay", "--verify", str(path)])
    assert verified.exit_code == 1
    assert wrong[0] in verified.output


@pytest.mark.parametrize("size", [8, 9, 40])
def test_a_file_cut_before_its_first_message_is_an_error(recording: Path, tmp_path: Path, size: int) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(recording.read_bytes()[:size])
    result = runner.invoke(app, ["export", str(path), str(tmp_path / "out.csv")])
    assert result.exit_code == 1
    assert "cut.mcap: holds none of our messages" in result.output
    assert [one.name for one in tmp_path.iterdir()] == ["cut.mcap"]
    assert runner.invoke(app, ["replay", "--verify", str(path)]).exit_code == 1


def test_parquet_has_types(recording: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "all.parquet"
    result = runner.invoke(app, ["export", str(recording), str(out)])
    assert result.exit_code == 0, result.output
    table = parquet.read_table(out)
    types = {name: str(table.schema.field(name).type) for name in ("stamp_ns", "range_m", "approaching", "because")}
    assert types == {"stamp_ns": "int64", "range_m": "double", "approaching": "bool", "because": "string"}
    rows = table.to_pylist()
    assert len(rows) == 420
    radar = next(row for row in rows if row["table"] == "radar")
    assert (radar["track_id"], radar["range_m"], radar["approaching"], radar["because"]) == (1, 9.0, True, None)


def test_without_its_extra_parquet_says_what_is_missing(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    out = tmp_path / "all.parquet"
    result = runner.invoke(app, ["export", str(recording), str(out)])
    assert result.exit_code == 1
    assert "extra `parquet`" in result.output
    assert not out.exists()
