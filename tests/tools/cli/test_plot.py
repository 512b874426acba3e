"""Pictures: of every message that has one, of a recording, and a clear word where there is none."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from matplotlib import image as mpl_image
from typer.testing import CliRunner

from common import messages as m
from spotter_tools.cli.__main__ import app
from spotter_tools.plots.fields import COLUMNS, fields
from spotter_tools.plots.message import _DRAWINGS, plot_message
from spotter_tools.plots.paper import new_figure
from spotter_tools.plots.story import Story

pytestmark = pytest.mark.patient

runner = CliRunner()
Until = Callable[[Callable[[], object]], None]


def picture_of(path: Path) -> np.ndarray:
    """(H, W, 3) in 0..1; a picture that is all one colour would be no picture."""
    picture = mpl_image.imread(path)[..., :3]
    assert picture.shape[0] > 400
    assert picture.std() > 0.02
    return picture


def png() -> bytes:
    stream = io.BytesIO()
    mpl_image.imsave(stream, np.zeros((8, 8, 3)), format="png")
    return stream.getvalue()


@pytest.fixture(scope="module")
def samples(speakers: ModuleType) -> dict[str, m.Message]:
    """One message of every kind that can be drawn."""
    cloud = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    cluster = m.Cluster(
        label="car", confidence=0.7, centre_m=(3.0, 4.0, 0.5), size_m=(4.0, 2.0, 1.5), yaw_rad=0.1, points=9
    )
    messages = [
        speakers.verdict(10), speakers.health(10, "degraded"), speakers.zones(10), speakers.radar(10),
        speakers.objects(10), speakers.camera(10),
        m.LaserScan(
            stamp_ns=1, angles_rad=np.linspace(0, 6, 9, dtype=np.float32), ranges_m=np.arange(9, dtype=np.float32),
            confidence=np.full(9, 200, np.uint8),
        ),
        m.RadarDetections(
            stamp_ns=1, detections=[m.RadarDetection(range_m=2.0, azimuth_rad=None, velocity_mps=0.5, snr_db=9.0)],
            range_doppler_db=np.outer(np.arange(8.0), np.ones(4)), range_axis_m=np.arange(8.0),
            velocity_axis_mps=np.linspace(-1, 1, 4),
        ),
        m.PointCloud(
            stamp_ns=1, points=cloud, intensity=np.zeros(50, np.uint8), kind=np.arange(50, dtype=np.uint8) % 4
        ),
        m.Clusters(stamp_ns=1, clusters=[cluster]),
        m.CompressedImage(stamp_ns=1, format="png", data=png()),
        m.ServiceStatus(
            stamp_ns=1, state="online", reason="", published=5, dropped=0, bad_input=0, rate_hz=10.0,
            last_frame_age_s=0.1, stage_ms={"read": 1.0, "find": 2.0}, rss_mb=70.0,
        ),
    ]  # fmt: skip
    return {type(message).__name__: message for message in messages}


@pytest.mark.parametrize("kind", sorted(kind.__name__ for kind in _DRAWINGS))
def test_every_message_with_a_picture_has_one(samples: dict[str, m.Message], kind: str, tmp_path: Path) -> None:
    plot_message("host/service/product", samples[kind], tmp_path / "out.png")
    picture_of(tmp_path / "out.png")


@pytest.mark.parametrize(
    "message",
    [
        m.EgoMotion(stamp_ns=1, speed_mps=1.0, yaw_rate_radps=None),
        m.RawBytes(stamp_ns=1, kind="ld06", index=3, data=np.arange(9, dtype=np.uint8), about={"$": {"x_m": [1.0]}}),
    ],
    ids=lambda message: type(message).__name__,
)
def test_a_message_without_a_picture_is_drawn_as_its_fields(message: m.Message, tmp_path: Path) -> None:
    plot_message("host/service/product", message, tmp_path / "out.png")
    assert (picture_of(tmp_path / "out.png") < 0.5).any()


def test_fields_are_named_with_their_values_and_arrays_summed_up() -> None:
    inputs = {"lidar": {"age_s": 0.1}, "more": list(range(99))}
    trace = m.FusionTrace(stamp_ns=7, verdict_seq=3, inputs=inputs, memory={}, rules={})
    axes = new_figure().subplots()
    fields(axes, trace)
    text = axes.texts[0].get_text().splitlines()
    assert "verdict_seq: 3" in text
    assert "inputs.lidar.age_s: 0.1" in text
    assert max(map(len, text)) <= COLUMNS
    axes = new_figure().subplots()
    fields(axes, m.RawBytes(stamp_ns=1, kind="ld06", index=3, data=np.arange(9, dtype=np.uint8)))
    assert "data: uint8 (9,), 0 to 8" in axes.texts[0].get_text()


def test_a_recording_becomes_one_page(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "story.png"
    result = runner.invoke(app, ["plot", str(recording), str(out)])
    assert result.exit_code == 0, result.output
    picture = picture_of(out)
    for level_colour in ("#1f7a45", "#e09a00", "#c8102e"):
        wanted = [int(level_colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        assert (np.abs(picture - wanted).max(axis=2) < 0.02).sum() > 500, level_colour


def test_a_part_of_a_recording_can_be_drawn(recording: Path, tmp_path: Path) -> None:
    result = runner.invoke(app, ["plot", str(recording), str(tmp_path / "part.png"), "--from", "4.5", "--to", "5.5"])
    assert result.exit_code == 0, result.output
    picture = picture_of(tmp_path / "part.png")
    caution = np.abs(picture - [0xE0 / 255, 0x9A / 255, 0.0]).max(axis=2) < 0.02
    assert caution.sum() < 100  # only IMMINENT is left


def test_the_story_is_told_in_spans_with_causes(speakers: ModuleType) -> None:
    story = Story()
    for tick in range(30):
        level = "SAFE" if tick < 10 else "CAUTION"
        story.add(tick / 10, speakers.verdict(1 + tick, level))
        story.add(tick / 10, speakers.health(1 + tick, "degraded" if tick >= 20 else "online"))
        story.add(tick / 10, speakers.radar(1 + tick, 9.0 - tick / 10))
    story.add(9.0, speakers.verdict(99, "CAUTION"))
    assert [(span.start_s, span.end_s, span.what) for span in story.verdicts] == [
        (0.0, 1.0, "SAFE"), (1.0, 2.9, "CAUTION"), (9.0, 9.0, "CAUTION"),
    ]  # fmt: skip
    assert [span.why for span in story.changes()] == ["lidar SAFE at 0.61 m", "lidar CAUTION at 0.61 m"]
    assert [(span.start_s, span.what) for span in story.sensors["lidar"]] == [(0.0, "online"), (2.0, "degraded")]
    assert story.ranges_m["radar"][-1] == (2.9, pytest.approx(6.1))
    assert story.ttc_s[0] == (0.0, pytest.approx(6.0))
    assert story.length_s == 9.0


def test_an_empty_radar_leaves_a_gap(speakers: ModuleType) -> None:
    story, empty = Story(), speakers.radar(1)
    empty.tracks.clear()
    story.add(0.0, empty)
    assert math.isnan(story.ranges_m["radar"][0][1])


def test_a_live_message_is_drawn(speaking: str, tmp_path: Path) -> None:
    out = tmp_path / "live.png"
    result = runner.invoke(app, ["plot", "*/radar/tracks", str(out), "--connect", speaking, "--timeout", "20"])
    assert result.exit_code == 0, result.output
    picture_of(out)


@pytest.mark.parametrize(
    ("what", "error_text", "code"),
    [
        ("missing.mcap", "missing.mcap: no such file", 2),
        ("pi7/radar/tracks", "nobody publishes pi7/radar/tracks: no service is alive", 1),
    ],
)
def test_what_is_not_there_is_said(router_endpoint: str, tmp_path: Path, what: str, error_text: str, code: int) -> None:
    command = ["plot", what, str(tmp_path / "out.png"), "--connect", router_endpoint, "--timeout", "0.1"]
    result = runner.invoke(app, command)
    assert result.exit_code == code
    assert error_text in result.output
