"""Stills for the calibration: upright, full size, nothing drawn in, and said of each whether the board is in it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from services.jetson.camera.__main__ import app
from services.jetson.camera.config import CameraConfig, CaptureConfig
from services.jetson.camera.snap import take
from tests.jetson.camera.training.boards import board_picture


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """A folder of pictures: two with a board, one without, taken by a camera that hangs upside down."""
    folder = tmp_path / "camera"
    folder.mkdir()
    boards = [board_picture((0.3, 0.1 * i, 0.0), (-4.0, -2.5, 11.0)) for i in range(2)]
    for number, image in enumerate([*boards, np.full((480, 640, 3), 90, np.uint8)]):
        cv2.imwrite(str(folder / f"{number}.png"), image[::-1, ::-1])
    return folder


def test_stills_are_what_the_service_gets(video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = CameraConfig(source=f"file:{video}?rate=2&fps=10", capture=CaptureConfig(rotate_deg=180))
    board = tmp_path / "board"
    board.mkdir()
    (board / "007.png").touch()  # an earlier one is not written over
    assert take(config, board, (3, 0.001), (9, 6)) == 2  # every picture, however late it comes
    names = [board / f"{number:03}.png" for number in (8, 9, 10)]
    assert sorted(board.iterdir()) == [board / "007.png", *names]
    first = board_picture((0.3, 0.0, 0.0), (-4.0, -2.5, 11.0))
    assert np.array_equal(cv2.imread(str(names[0])), first)
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"{names[0]}  640 x 480  board, ")
    assert said[2].endswith("no board")


@pytest.mark.parametrize(
    ("source", "code", "message"),
    [
        ("v4l2:/dev/video99", 1, "spotter: /dev/video99 is not there; plug the camera in"),
        ("file:/no/such", 2, "no such file or folder"),
        ("sim:crossing", 0, "0 of 1 pictures show the board of 9 x 6 corners"),
    ],
)
def test_the_command_ends_with_words(tmp_path: Path, source: str, code: int, message: str) -> None:
    command = [
        sys.executable,
        "-m",
        "services.jetson.camera",
        "--source",
        source,
        "snap",
        str(tmp_path),
        "--count",
        "1",
    ]
    done = subprocess.run([*command, "--every", "0.2"], capture_output=True, text=True, check=False)
    assert (done.returncode, message in done.stdout + done.stderr) == (code, True), done


@pytest.mark.parametrize("option", ["--columns", "--rows"])
def test_a_board_smaller_than_can_be_found_is_refused(tmp_path: Path, option: str) -> None:
    result = CliRunner().invoke(app, ["--source", "sim:empty", "snap", str(tmp_path / "board"), option, "2"])
    assert (result.exit_code, option in result.output) == (2, True), result.output
    assert not (tmp_path / "board").exists()
