"""Numbers that are no metres, intensities or rings are refused in every format; odd points are left out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.plausible import in_metres, with_plausible_columns
from services.infra_lidar.input.point_files import parse_frame
from tests.infra_lidar.made_frames import npy, npz

HEADER = "FIELDS x y z intensity ring\nSIZE 4 4 4 4 4\nTYPE F F F F F\nWIDTH {}\nDATA binary\n"
NAMES = ("x", "y", "z", "intensity", "ring")


def street(count: int = 2000) -> np.ndarray:
    """(N, 5) float32: x, y over 40 m, heights of 2 m, intensity and ring."""
    rng = np.random.default_rng(1)
    xyz = np.column_stack([rng.uniform(-40, 40, (count, 2)), rng.uniform(-2, 0.5, count)])
    return np.column_stack([xyz, rng.integers(0, 256, count), rng.integers(0, 128, count)]).astype(np.float32)


def pcd(rows: np.ndarray) -> bytes:
    return HEADER.format(len(rows)).encode() + rows.tobytes()


def ply(rows: np.ndarray) -> bytes:
    properties = "".join(f"property float {name}\n" for name in NAMES)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    return head.encode() + rows.tobytes()


def npz_of(rows: np.ndarray) -> bytes:
    return npz(xyz=rows[:, :3], intensity=rows[:, 3], ring=rows[:, 4])


FORMATS: list[tuple[str, Callable[[np.ndarray], bytes]]] = [
    ("a.bin", np.ndarray.tobytes), ("a.npy", npy), ("a.npz", npz_of), ("a.pcd", pcd), ("a.ply", ply),
]  # fmt: skip


@pytest.mark.parametrize(("name", "write"), FORMATS)
def test_a_street_is_read_from_every_format(name: str, write: Callable[[np.ndarray], bytes]) -> None:
    np.testing.assert_array_equal(parse_frame(name, write(street())).points, street())


def some(count: int, value: float) -> np.ndarray:
    """A street of which so many points of 2000 lie there."""
    rows = street()
    rows[:count, :3] = value
    return rows


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (some(2000, 0.0), "all 2000 points are 0 0 0: none is a return"),
        (street() * np.float32(1e-6), "2000 of 2000 points lie within 10 cm of the sensor: expected metres"),
        (street() * np.float32(1e-3), "2000 of 2000 points lie within 10 cm of the sensor: expected metres"),
        (some(1900, 0.01), "1900 of 2000 points lie within 10 cm of the sensor"),
        (some(800, 1e30), r"800 of 2000 points lie beyond 1000 m, up to 1e\+30: expected metres"),
        (some(3, 1001.0), r"3 of 2000 points lie beyond 1000 m, up to 1e\+03: expected metres"),
        (some(1500, 1e30), "half of the points are farther than"),
        (np.where(np.arange(2000)[:, None] % 5 < 3, 0, street() * 1000).astype(np.float32), "are these millimetres"),
    ],
)
def test_what_is_no_metres_is_refused(rows: np.ndarray, words: str) -> None:
    with pytest.raises(FrameError, match=words):
        in_metres(rows)


@pytest.mark.parametrize("value", [1e30, -1001.0, np.inf, np.nan])
def test_single_odd_points_are_left_out(value: float) -> None:
    np.testing.assert_array_equal(in_metres(some(1, value)), street()[1:])


@pytest.mark.parametrize(("count", "value"), [(1900, 0.0), (1000, 0.05), (2, 900.0)])
def test_points_without_a_return_and_close_ones_stay(count: int, value: float) -> None:
    np.testing.assert_array_equal(in_metres(some(count, value)), some(count, value))


@pytest.mark.parametrize(("name", "write"), [one for one in FORMATS if one[0] != "a.bin"])
@pytest.mark.parametrize("value", [1e9, np.nan, -5.0, 0.5])
def test_a_ring_that_is_none_is_refused(name: str, write: Callable[[np.ndarray], bytes], value: float) -> None:
    rows = street()
    rows[7, 4] = value
    if name == "a.npz" and value in (1e9, -5.0):  # clipped, as documented
        return
    with pytest.raises(FrameError) as raised:
        parse_frame(name, write(rows))
    assert f"ring: whole numbers from 0 to 255 are expected, found {value:g}" in str(raised.value)


@pytest.mark.parametrize(("name", "write"), [("a.npy", npy), ("a.pcd", pcd)])
@pytest.mark.parametrize("value", [np.nan, -1e30, 70_000.0])
def test_an_intensity_that_is_none_is_refused(name: str, write: Callable[[np.ndarray], bytes], value: float) -> None:
    rows = street()
    rows[7, 3] = value
    with pytest.raises(FrameError) as raised:
        parse_frame(name, write(rows))
    assert f"intensity: expected 0 to 65535, found {value:g}" in str(raised.value)


def test_columns_that_were_asked_for_are_checked_too() -> None:
    rows = street()
    rows[:, 4] = 0.5
    with pytest.raises(FrameError, match=r"ring: whole numbers from 0 to 255 are expected, found 0\.5; leave it out"):
        parse_frame("a.bin", rows.tobytes(), NAMES)


def test_a_point_without_a_return_needs_no_ring() -> None:
    rows = street()
    rows[3] = np.nan
    assert len(parse_frame("a.pcd", pcd(rows)).points) == 1999
    assert with_plausible_columns(rows[:3, :3]).shape == (3, 3)
