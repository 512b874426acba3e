"""The top view: pictures are drawn, trails grow and end with their tracks."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the plot extra")

from common.config import ConfigError
from common.messages import ObjectTrack
from services.infra_lidar import plot
from services.infra_lidar.__main__ import main
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.source import surveyed_pose
from services.infra_lidar.result import FrameResult
from services.infra_lidar.warm_up import made_up_revolution


def track(track_id: int, x: float) -> ObjectTrack:
    return ObjectTrack(
        track_id=track_id, label="car", label_confidence=0.9, position_m=(x, 1.0, 0.7), velocity_mps=(5.0, 0.0, 0.0),
        covariance=np.eye(6).tolist(), size_m=(4.0, 1.8, 1.5), yaw_rad=0.3, age_s=1.0, score=0.8, state="confirmed",
        points=50,
    )  # fmt: skip


def test_trails_grow_and_end_with_their_tracks() -> None:
    trails = plot.Trails()
    trails.update([track(1, 0.0), track(2, 5.0)])
    first, second = trails.update([track(1, 1.0), track(2, 6.0)])
    assert first.tolist() == [[0.0, 1.0], [1.0, 1.0]]
    assert second[:, 0].tolist() == [5.0, 6.0]
    trails.update([track(2, 7.0)])
    assert trails.update([track(1, 9.0)])[0].tolist() == [[9.0, 1.0]]


def test_what_drives_along_x_goes_up_the_page() -> None:
    (line,) = plot.to_axes([np.array([[0.0, 3.0], [5.0, 3.0]])])
    assert line.tolist() == [[3.0, 0.0], [3.0, 5.0]]


def recorded(folder: Path, frames: int) -> InfraLidarConfig:
    folder.mkdir()
    for number in range(frames):
        points = made_up_revolution().points
        np.savez(folder / f"{number:03d}.npz", xyz=points[:, :3], intensity=points[:, 3], stamp=1e9 + 0.1 * number)
    return InfraLidarConfig(source=f"file:{folder}?rate=0")


def test_a_folder_of_pictures(tmp_path: Path) -> None:
    config = recorded(tmp_path / "recording", 4)
    assert plot.plot_source(config, tmp_path / "out", frames=3, reach_m=20.0) == 3
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["00000.png", "00001.png", "00002.png"]
    assert (tmp_path / "out" / "00002.png").read_bytes()[:4] == b"\x89PNG"


def test_one_picture_is_that_of_the_last_frame(tmp_path: Path) -> None:
    config = recorded(tmp_path / "recording", 3)
    assert plot.plot_source(config, tmp_path / "new" / "out.png", frames=10, reach_m=20.0) == 3
    plot.plot_source(config, tmp_path / "all", frames=10, reach_m=20.0)
    assert (tmp_path / "new" / "out.png").read_bytes() == (tmp_path / "all" / "00002.png").read_bytes()


def test_a_gif_has_every_frame(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="comes with matplotlib")
    config = recorded(tmp_path / "recording", 3)
    assert plot.plot_source(config, tmp_path / "out.gif", frames=2, reach_m=20.0) == 2
    with image.open(tmp_path / "out.gif") as moving:
        assert moving.size == (1000, 1000)
        assert moving.get_format_mimetype() == "image/gif"


@pytest.mark.parametrize("output", ["out.png", "out.gif", "out"])
def test_a_source_of_which_no_frame_can_be_read_says_so(output: str, tmp_path: Path) -> None:
    (tmp_path / "recording").mkdir()
    (tmp_path / "recording" / "000.npz").write_bytes(b"no frame")
    config = InfraLidarConfig(source=f"file:{tmp_path / 'recording'}?rate=0")
    with pytest.raises(ConfigError, match="no frame in it can be read"):
        plot.plot_source(config, tmp_path / output, frames=2, reach_m=20.0)


def test_a_gif_of_nothing_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plot, "open_source", lambda config, report: iter(()))
    assert plot.plot_source(InfraLidarConfig(source="sim:crossing"), tmp_path / "out.gif", 2, 20.0) == 0
    assert list(tmp_path.iterdir()) == []


def test_the_simulated_sensor_stands_where_it_does_in_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, centres = InfraLidarConfig(source="sim:crossing?columns=300"), []

    def drawn(result: FrameResult, trails: list[np.ndarray], reach_m: float) -> np.ndarray:
        centres.append(result.T_map_sensor[:3, 3])
        return np.zeros((4, 4, 3), np.uint8)

    monkeypatch.setattr(plot, "draw", drawn)
    plot.plot_source(config, tmp_path / "out.png", frames=1, reach_m=20.0)
    np.testing.assert_allclose(centres, [np.reshape(surveyed_pose(config), (4, 4))[:3, 3]], atol=1e-6)


def test_the_flag_of_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = recorded(tmp_path / "recording", 2)
    out = tmp_path / "flag.png"
    words = ["spotter-infra-lidar", "--plot", str(out), "--source", config.source, "--frames", "1", "--reach=20"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as ending:
        main()
    assert ending.value.code == 0
    assert capsys.readouterr().out == f"{out}: the last of 1 frames\n"
    assert out.read_bytes()[:4] == b"\x89PNG"


def test_a_video_has_every_frame(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="no OpenCV")
    config = recorded(tmp_path / "recording", 2)
    assert plot.plot_source(config, tmp_path / "out.mp4", frames=10, reach_m=20.0) == 2
    video = cv2.VideoCapture(str(tmp_path / "out.mp4"))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == 2
    video.release()


def test_a_missing_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="does not exist"):
        plot.plot_source(InfraLidarConfig(source=f"file:{tmp_path}/none"), tmp_path / "out", 1, 20.0)
