"""Tracks out of recordings: on the Earth, as OpenLABEL, as KITTI results; read again by others' rules and readers."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from kognic.openlabel.models import OpenLabelAnnotation
from typer.testing import CliRunner

from benchmarks.datasets.kitti_format import read_rows
from common.codec import encode
from common.geodesy import MapOrigin, wgs84_to_map
from common.recording.file import RecordingFile
from spotter_tools.cli.__main__ import app

runner = CliRunner()
SITE = "[map]\nlatitude_deg = 52.5163\nlongitude_deg = 13.3777\naltitude_m = 40.0\nheading_deg = 30.0\n"
ORIGIN = MapOrigin(latitude_deg=52.5163, longitude_deg=13.3777, altitude_m=40.0, heading_deg=30.0)


def export(recording: Path, out: Path, *arguments: str, code: int = 0) -> str:
    result = runner.invoke(app, ["export", str(recording), str(out), *arguments])
    assert result.exit_code == code, result.output
    return str(result.output)


@pytest.fixture
def site(tmp_path: Path) -> str:
    (tmp_path / "site.toml").write_text(SITE)
    return str(tmp_path / "site.toml")


@pytest.fixture
def two_hosts(tmp_path: Path, speakers: Any) -> Path:
    """A car of one host in three messages, another host's that leaves for a frame, and a frame of somebody else."""
    path = tmp_path / "two.mcap"
    with RecordingFile(path, {"spotter": {"version": "test"}}) as file:
        for tick in range(3):
            for host, frame_id in (("infra0", "map"), ("infra1", "map" if tick != 1 else "lidar")):
                message = speakers.objects(1_700_000_000_000_000_000 + tick * 100_000_000, 3.0 + tick)
                message.frame_id = frame_id
                file.add(
                    f"{host}/infra_lidar/tracks", type(message), encode(message), message.stamp_ns, message.stamp_ns, 0
                )
    return path


def test_a_way_is_a_line_on_the_earth(recording: Path, tmp_path: Path, site: str) -> None:
    out = tmp_path / "tracks.geojson"
    assert "1 tracks" in export(recording, out, "--site", site)
    (feature,) = json.loads(out.read_text())["features"]
    places, about = np.array(feature["geometry"]["coordinates"]), feature["properties"]
    assert (feature["type"], feature["geometry"]["type"], feature["id"]) == ("Feature", "LineString", "infra0/7")
    back = wgs84_to_map(ORIGIN, places[:, [1, 0, 2]])
    np.testing.assert_allclose(back[:, 0], 3.0 + 0.3 * np.arange(60), atol=2e-3)
    np.testing.assert_allclose(back[:, 1:], [[4.0, 0.7]] * 60, atol=2e-3)
    assert (about["label"], about["speed_mps"], about["source_kind"]) == ("car", 5.0, "unknown")
    assert len(about["stamps_ns"]) == len(about["speeds_mps"]) == 60
    assert about["course_deg"] == pytest.approx((30.0 - math.degrees(math.atan2(4, 3))) % 360, abs=0.01)
    assert about["heading_deg"] == pytest.approx((30.0 - math.degrees(0.9)) % 360, abs=0.01)


def test_the_same_id_at_two_hosts_is_two_ways_and_another_frame_is_left_out(
    two_hosts: Path, tmp_path: Path, site: str
) -> None:
    out = tmp_path / "tracks.geojson"
    assert "1 messages in the frame lidar, not map, left out" in export(two_hosts, out, "--site", site)
    features = json.loads(out.read_text())["features"]
    assert {one["id"]: len(one["geometry"]["coordinates"]) for one in features} == {"infra0/7": 3, "infra1/7": 2}
    export(two_hosts, out, "--site", site, "--host", "infra1", "--force")
    assert [one["id"] for one in json.loads(out.read_text())["features"]] == ["infra1/7"]


def openlabel_schema() -> Any:
    """ASAM's own schema of version 1.0.0, as kognic-openlabel carries it."""
    package = importlib.util.find_spec("kognic.openlabel.schemas")
    assert package is not None
    folder = next(iter(package.submodule_search_locations or ()))
    return json.loads((Path(folder) / "openlabel-1-0-0.json").read_text())


def test_openlabel_keeps_the_rules_of_its_schema(two_hosts: Path, tmp_path: Path, site: str) -> None:
    out = tmp_path / "drive.json"
    assert "2 objects, 6 frames" in export(two_hosts, out, "--as", "openlabel", "--site", site)
    document = json.loads(out.read_text())
    jsonschema.validate(document, openlabel_schema())
    label = OpenLabelAnnotation.model_validate(document).openlabel
    assert label.frames is not None
    assert label.objects is not None
    assert [one.name for one in label.objects.values()] == ["infra0/7", "infra1/7"]
    spans = [(span.frame_start, span.frame_end) for span in label.objects["1"].frame_intervals or ()]
    assert spans == [(1, 1), (3, 3), (5, 5)]
    cuboid = document["openlabel"]["frames"]["2"]["objects"]["0"]["object_data"]["cuboid"][0]
    assert cuboid["val"] == [4.0, 4.0, 0.7, 0.0, 0.0, 0.9, 4.0, 1.8, 1.5]
    assert document["openlabel"]["frames"]["2"]["frame_properties"]["timestamp"] == "2023-11-14T22:13:20.100000000Z"
    assert document["openlabel"]["metadata"]["map_origin_wgs84"]["heading_deg"] == 30.0
    assert set(document["openlabel"]["coordinate_systems"]) == {"map", "lidar"}


def test_the_schema_refuses_what_is_wrong(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "drive.json"
    export(recording, out, "--as", "openlabel")
    document = json.loads(out.read_text())
    document["openlabel"]["objects"]["a"] = document["openlabel"]["objects"].pop("0")
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, openlabel_schema())


def test_kitti_leaves_out_what_is_not_in_the_map(two_hosts: Path, tmp_path: Path) -> None:
    out = tmp_path / "tracks.txt"
    output = export(two_hosts, out, "--as", "kitti", "--host", "infra1")
    assert "1 messages in the frame lidar, not map, left out" in output
    assert [line.split()[0] for line in out.read_text().splitlines()] == ["0", "2"]


def test_kitti_results_are_read_again_by_the_reader_of_the_benchmark(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "0000.txt"
    assert "60 frames, 60 lines" in export(recording, out, "--as", "kitti")
    rows = read_rows(out)
    assert (rows.frame.tolist(), set(rows.track), set(rows.kind)) == (list(range(60)), {7}, {"Car"})
    np.testing.assert_allclose(rows.box[0], [-4.0, 1.5 / 2 - 0.7, 3.0, 1.5, 1.8, 4.0, -0.9 - math.pi / 2], atol=1e-6)
    assert rows.score[0] == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("arguments", "error_text"),
    [
        (["out.geojson"], "where the map lies is not known: give [map] latitude_deg"),
        (["out.txt"], "--as csv, parquet, geojson, openlabel, kitti"),
        (["out.txt", "--as", "shapefile"], "--as csv, parquet, geojson, openlabel, kitti"),
        (
            ["out.txt", "--as", "kitti"],
            "tracks of infra0 and infra1, and a KITTI file holds one sensor's frames: choose",
        ),
        (["out.txt", "--as", "kitti", "--host", "infra9"], "no tracks of it; of: infra0, infra1"),
        (["out.txt", "--as", "kitti", "--table", "objects"], "kitti holds tracks, no tables"),
    ],
)
def test_what_cannot_be_done_is_said(
    two_hosts: Path, tmp_path: Path, arguments: list[str], error_text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SPOTTER_SITE", raising=False)
    assert error_text in export(two_hosts, Path(arguments[0]), *arguments[1:], code=2)
    assert not (tmp_path / arguments[0]).exists()


def test_a_recording_without_roadside_tracks(tmp_path: Path, speakers: Any) -> None:
    path = tmp_path / "verdicts.mcap"
    with RecordingFile(path, {"spotter": {"version": "test"}}) as file:
        message = speakers.verdict(1_700_000_000_000_000_000)
        file.add("jetson0/fusion/verdict", type(message), encode(message), message.stamp_ns, message.stamp_ns, 0)
    assert "holds no infra_lidar/tracks" in export(path, tmp_path / "x.json", "--as", "openlabel", code=1)


@pytest.mark.parametrize("wrong", ["latitude_deg = 91.0", "longitude_deg = 13.0"])
def test_a_wrong_origin_is_refused_by_name(recording: Path, tmp_path: Path, wrong: str) -> None:
    (tmp_path / "site.toml").write_text(f"[map]\nheading_deg = 0.0\n{wrong}\n")
    output = export(recording, tmp_path / "out.geojson", "--site", str(tmp_path / "site.toml"), code=2)
    assert "latitude_deg" in output


@pytest.mark.parametrize("form", ["geojson", "openlabel", "kitti"])
def test_tracks_that_cannot_be_read_are_not_called_missing(tmp_path: Path, speakers: Any, site: str, form: str) -> None:
    path = tmp_path / "wrong.mcap"
    with RecordingFile(path, {"spotter": {"version": "test"}}) as file:
        message = speakers.objects(1_700_000_000_000_000_000, 3.0)
        payload = encode(message)[:-20]
        file.add("infra0/infra_lidar/tracks", type(message), payload, message.stamp_ns, message.stamp_ns, 0)
    output = export(path, tmp_path / "out", "--as", form, "--site", site, code=1)
    assert "1 messages could not be read, no others of their kind are there: 1 of infra0/infra_lidar/tracks" in output
