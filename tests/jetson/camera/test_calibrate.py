"""The calibration command, on chessboard pictures drawn with a known lens and on one object of known size."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from common.config import load
from common.sim import camera as simulated
from common.sim.world import T_vehicle_camera, world_at
from services.jetson.camera.__main__ import app
from services.jetson.camera.calibrate import CalibrationError, from_chessboard, from_object, with_lens
from services.jetson.camera.config import CameraConfig, LensConfig

COLUMNS, ROWS = 9, 6
TRUE = np.array([[520.0, 0, 315.0], [0, 505.0, 245.0], [0, 0, 1]])


def board_picture(rotation_rad: tuple[float, float, float], place_squares: tuple[float, float, float]) -> np.ndarray:
    """A chessboard of 10 x 7 squares as a camera with the true lens sees it."""
    cell = 40
    flat = np.full(((ROWS + 3) * cell, (COLUMNS + 3) * cell), 255, np.uint8)
    for row in range(ROWS + 1):
        for column in range(COLUMNS + 1):
            if (row + column) % 2:
                flat[(row + 1) * cell : (row + 2) * cell, (column + 1) * cell : (column + 2) * cell] = 0
    rotation, _ = cv2.Rodrigues(np.array(rotation_rad))
    # pixels of the flat board -> squares, origin at the first inner corner -> picture
    to_squares = np.array([[1 / cell, 0, -2], [0, 1 / cell, -2], [0, 0, 1]])
    to_picture = TRUE @ np.column_stack([rotation[:, 0], rotation[:, 1], place_squares]) @ to_squares
    grey = cv2.warpPerspective(flat, to_picture, (640, 480), flags=cv2.INTER_AREA, borderValue=128)
    return cv2.cvtColor(cv2.GaussianBlur(grey, (3, 3), 0), cv2.COLOR_GRAY2BGR)


@pytest.fixture(scope="module")
def boards() -> list[np.ndarray]:
    tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.5, 0.1), (0.1, -0.5, 0), (0.3, 0.3, 0.2), (-0.3, -0.3, 0)]
    return [board_picture(tilt, (-4.0 + i * 0.3, -2.5 + i * 0.1, 11.0 + i * 0.4)) for i, tilt in enumerate(tilts)]


def test_chessboards_give_back_the_lens(boards: list[np.ndarray]) -> None:
    result = from_chessboard([*boards, np.full((480, 640, 3), 128, np.uint8)], COLUMNS, ROWS)
    assert result.used == len(boards)
    assert result.error_px < 0.3
    assert result.lens.f_x_px == pytest.approx(520, rel=0.015)
    assert result.lens.f_y_px == pytest.approx(505, rel=0.015)
    assert result.lens.c_x_px == pytest.approx(315, abs=6)
    assert (result.lens.width_px, result.lens.height_px) == (640, 480)


def test_too_few_boards_and_mixed_sizes_are_refused(boards: list[np.ndarray]) -> None:
    with pytest.raises(CalibrationError, match="in 2 of 2 pictures, needs 5"):
        from_chessboard(boards[:2], COLUMNS, ROWS)
    with pytest.raises(CalibrationError, match="pictures of one size"):
        from_chessboard([boards[0], boards[1][:400]], COLUMNS, ROWS)


def test_one_object_of_known_height_and_distance() -> None:
    assert from_object(640, 480, 200.0, 1.70, 3.40).f_y_px == pytest.approx(400.0)
    with pytest.raises(CalibrationError, match="must be positive"):
        from_object(640, 480, 0.0, 1.7, 3.0)


@pytest.mark.parametrize(
    "before",
    [
        "",
        'host = "jetson0"\n',
        '[lens]\nf_y_px = 1.5  # old\nwidth_px = 99\n\n[zone]\nwidth = 0.5\n',
        '[zone]\nwidth = 0.5\n\n[lens]\nf_y_px = 1.5',
    ],
)  # fmt: skip
def test_only_the_lens_section_of_the_file_changes(before: str) -> None:
    lens = LensConfig(f_y_px=512.25)
    once = with_lens(before, lens)
    document = tomllib.loads(once)
    assert document.pop("lens")["f_y_px"] == 512.25
    expected = tomllib.loads(before)
    expected.pop("lens", None)
    assert document == expected
    assert with_lens(once, lens).split() == once.split()


def test_the_command_writes_what_the_service_then_reads(boards: list[np.ndarray], tmp_path: Path) -> None:
    for number, board in enumerate(boards):
        cv2.imwrite(str(tmp_path / f"{number}.png"), board)
    out = tmp_path / "camera.toml"
    out.write_text("# mine\n[zone]\nwidth = 0.5\n")
    pictures = [str(path) for path in sorted(tmp_path.glob("*.png"))]
    result = CliRunner().invoke(app, ["calibrate", "chessboard", *pictures, "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "6 of 6 pictures" in result.output
    config = load(CameraConfig, out)
    assert config.lens.f_y_px == pytest.approx(505, rel=0.015)
    assert config.zone.width == 0.5
    assert out.read_text().startswith("# mine")


def test_the_object_command_takes_rows_by_hand_or_asks_the_network(tmp_path: Path) -> None:
    picture, out = tmp_path / "person.png", tmp_path / "camera.toml"
    t_s = 3.0
    person = next(box for box in simulated.boxes("crossing", t_s) if box.actor_id == 1)
    cv2.imwrite(str(picture), simulated.image("crossing", t_s))
    actor = next(actor for actor in world_at("crossing", t_s).actors if actor.actor_id == 1)
    distance_m = float(actor.position_m[0] - T_vehicle_camera[0, 3])
    common = [str(picture), "--height-m", "1.72", "--distance-m", f"{distance_m}", "--out", str(out)]
    by_hand = f"{person.box_xyxy_px[1]},{person.box_xyxy_px[3]}"
    for arguments, tolerance in (([*common, "--box", by_hand], 0.06), (common, 0.15)):
        result = CliRunner().invoke(app, ["calibrate", "object", *arguments])
        assert result.exit_code == 0, result.output
        assert load(CameraConfig, out).lens.f_y_px == pytest.approx(simulated.F_Y_PX, rel=tolerance)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [(["--box", "hello"], "expected TOP,BOTTOM"), (["--label", "bus"], "no bus found")],
)
def test_what_cannot_be_calibrated_is_said(tmp_path: Path, arguments: list[str], told: str) -> None:
    picture = tmp_path / "grey.png"
    cv2.imwrite(str(picture), np.full((480, 640, 3), 128, np.uint8))
    common = ["calibrate", "object", str(picture), "--height-m", "1.7", "--distance-m", "3"]
    result = CliRunner().invoke(app, [*common, *arguments, "--out", str(tmp_path / "out.toml")])
    assert result.exit_code != 0
    assert told in " ".join(result.output.replace("│", " ").split())
