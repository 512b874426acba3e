"""The calibration command, on chessboard pictures drawn with a known lens and on one object of known size."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from common.config import load
from services.jetson.camera.__main__ import app
from services.jetson.camera.config import CameraConfig, LensConfig
from services.jetson.camera.detector import DEMO_MODEL
from services.jetson.camera.training.calibrate import CalibrationError, from_chessboard, from_object, with_lens
from services.jetson.camera.training.coverage import Board, corners_by_field, uncovered
from spotter_sim import camera as simulated
from spotter_sim.world import T_vehicle_camera, world_at
from tests.jetson.camera.training.boards import COLUMNS, ROWS, board_picture, tilted_boards

Limit = Callable[[int], AbstractContextManager[None]]
Triple = tuple[float, float, float]


@pytest.fixture(scope="module")
def boards() -> list[np.ndarray]:
    return tilted_boards()


def test_chessboards_give_back_the_lens(boards: list[np.ndarray]) -> None:
    result = from_chessboard([*boards, np.full((480, 640, 3), 128, np.uint8)], COLUMNS, ROWS)
    assert result.used == len(boards)
    assert result.error_px < 0.3
    assert result.uncovered == []
    assert result.lens.f_x_px == pytest.approx(520, rel=0.015)
    assert result.lens.f_y_px == pytest.approx(505, rel=0.015)
    assert result.lens.c_x_px == pytest.approx(315, abs=6)
    assert (result.lens.width_px, result.lens.height_px) == (640, 480)


FRONTAL = [(0.0, 0.0, 0.02 * i) for i in range(6)]
PLACES = [(-4.0 + i * 0.6, -2.5 + i * 0.3, 10.0 + i * 1.5) for i in range(6)]


@pytest.mark.parametrize(
    ("views", "missing"),
    [
        (list(zip(FRONTAL, PLACES, strict=True)), "3 more with the board turned by 15 to 45 degrees"),
        ([((0.4, 0.1, 0.0), (-4.0, -2.5, 11.0))] * 6, "4 more from other places and distances (1 differ)"),
        ([((0.0, 0.0, 0.0), (-4.0, -2.5, 11.0))] * 6, "3 more with the board turned"),
    ],
    ids=["six frontal views", "one tilted view six times", "one frontal view six times"],
)
def test_boards_that_do_not_determine_the_lens_are_refused(views: list[tuple[Triple, Triple]], missing: str) -> None:
    with pytest.raises(CalibrationError, match="do not determine the lens") as refusal:
        from_chessboard([board_picture(*view) for view in views], COLUMNS, ROWS)
    assert missing in str(refusal.value)


def test_what_is_missing_is_drawn_although_it_is_refused(tmp_path: Path) -> None:
    """Six frontal boards in the middle and the lower right: green outlines there, amber fields around."""
    for number, view in enumerate(zip(FRONTAL, PLACES, strict=True)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), board_picture(*view))
    pictures, drawn = [str(path) for path in sorted(tmp_path.glob("*.png"))], tmp_path / "coverage.png"
    words = ["calibrate", "chessboard", *pictures, "--coverage", str(drawn), "--out", str(tmp_path / "camera.toml")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert f"where the boards lay is drawn in {drawn}" in result.output.replace("\n", "")
    assert not (tmp_path / "camera.toml").exists()
    picture = cv2.imread(str(drawn)).astype(int)
    assert picture.shape == (480, 640, 3)
    assert np.abs(picture - (80, 175, 76)).sum(axis=2).min() < 10  # outlines
    assert (picture[0, 20] == (0, 170, 255)).all()  # nothing lay in the upper left


def test_fields_of_the_picture_without_a_board_are_named() -> None:
    grid = np.array([[x, y] for y in (100.0, 200.0) for x in (30.0, 60.0, 90.0, 300.0, 350.0, 400.0)])
    counts = corners_by_field([Board(grid, 6)], 640, 480)
    assert counts.tolist() == [[3, 3, 0], [3, 3, 0], [0, 0, 0]]
    twice = corners_by_field([Board(grid, 6)] * 2, 640, 480)
    assert uncovered(twice) == ["upper right", "middle right", "lower left", "lower middle", "lower right"]
    assert uncovered(corners_by_field([], 640, 480))[4] == "middle"


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
    assert len(config.lens.distortion) == 5
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
    for arguments, tolerance in (([*common, "--box", by_hand], 0.06), ([*common, "--model", str(DEMO_MODEL)], 0.15)):
        result = CliRunner().invoke(app, ["calibrate", "object", *arguments])
        assert result.exit_code == 0, result.output
        assert load(CameraConfig, out).lens.f_y_px == pytest.approx(simulated.F_Y_PX, rel=tolerance)


def grey_picture(folder: Path) -> str:
    path = folder / "grey.png"
    cv2.imwrite(str(path), np.full((480, 640, 3), 128, np.uint8))
    return str(path)


def test_a_file_that_is_only_half_written_stays_as_it_was(tmp_path: Path, file_size_limit: Limit) -> None:
    out = tmp_path / "camera.toml"
    out.write_text(before := "# mine\n")
    out.chmod(0o640)
    words = ["calibrate", "object", grey_picture(tmp_path), "--height-m", "1.7", "--distance-m", "3"]
    words += ["--box", "100,300", "--out", str(out)]
    with file_size_limit(10):
        result = CliRunner().invoke(app, words)
    assert result.exit_code == 2, result.output
    assert "File too large; nothing in it was changed" in " ".join(result.output.replace("│", " ").split())
    assert out.read_text() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["camera.toml", "grey.png"]
    assert CliRunner().invoke(app, words).exit_code == 0
    assert (out.read_text()[:6], out.stat().st_mode & 0o777) == ("# mine", 0o640)


@pytest.mark.parametrize(("columns", "rows"), [("2", "6"), ("9", "2")])
def test_a_board_smaller_than_can_be_found_is_refused(tmp_path: Path, columns: str, rows: str) -> None:
    words = ["calibrate", "chessboard", grey_picture(tmp_path), "--columns", columns, "--rows", rows]
    result = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "camera.toml")])
    assert result.exit_code == 2, result.output
    assert re.search(r"'--(columns|rows)': .*(x>=|equal to )3", " ".join(result.output.replace("│", " ").split()))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--box", "hello"], "expected TOP,BOTTOM"),
        (["--model", str(DEMO_MODEL)], "no person found"),
        ([], "--box TOP,BOTTOM, or a network with --model"),
        (["--box", "10,12"], "a field of view of"),
    ],
)
def test_what_cannot_be_calibrated_is_said(tmp_path: Path, arguments: list[str], message: str) -> None:
    common = ["calibrate", "object", grey_picture(tmp_path), "--height-m", "1.7", "--distance-m", "3"]
    result = CliRunner().invoke(app, [*common, *arguments, "--out", str(tmp_path / "out.toml")])
    assert result.exit_code != 0
    assert message in " ".join(result.output.replace("│", " ").split())
