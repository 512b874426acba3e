"""PointCloud2 as drivers lay it out, and what is refused with which words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.pointcloud2 import DATATYPES, points_of_message

NUMBER_OF = {name: number for number, name in DATATYPES.items()}


@dataclass(frozen=True)
class Field:
    name: str
    offset: int
    datatype: int
    count: int = 1


@dataclass(frozen=True)
class Cloud:
    height: int
    width: int
    fields: list[Field]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: np.ndarray


def cloud_of(layout: list[tuple[str, str]], values: np.ndarray, order: str = "<", padding: tuple[int, int] = (0, 0)):
    """(H, W, F) values as a message; padding: bytes behind each point and behind each row."""
    record = np.dtype([(name, order + kind) for name, kind in layout])
    offsets = [record.fields[name][1] for name, _ in layout]
    height, width = values.shape[:2]
    step = record.itemsize + padding[0]
    row_step = step * width + padding[1]
    data = np.full(height * row_step, 0xAB, np.uint8)
    for row in range(height):
        for column in range(width):
            at = row * row_step + column * step
            point = np.array([tuple(values[row, column])], record)
            data[at : at + record.itemsize] = np.frombuffer(point.tobytes(), np.uint8)
    fields = [Field(name, offset, NUMBER_OF[kind]) for (name, kind), offset in zip(layout, offsets, strict=True)]
    return Cloud(height, width, fields, order == ">", step, row_step, data)


VELODYNE = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), ("time", "f4")]
OUSTER = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("t", "u4"), ("reflectivity", "u2"),
          ("ring", "u1"), ("ambient", "u2"), ("range", "u4")]  # fmt: skip
HESAI = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("timestamp", "f8"), ("ring", "u2")]
AUTOWARE = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "u1"), ("return_type", "u1"), ("channel", "u2")]
LIVOX = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("tag", "u1"), ("line", "u1")]
PLAIN = [("x", "f8"), ("y", "f8"), ("z", "f8")]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("layout", "columns"),
    [
        (VELODYNE, (0, 1, 2, 3, 4)),
        (OUSTER, (0, 1, 2, 5, 6)),
        (HESAI, (0, 1, 2, 3, 5)),
        (AUTOWARE, (0, 1, 2, 3, 5)),
        (LIVOX, (0, 1, 2, 3, 5)),
        (PLAIN, (0, 1, 2)),
    ],
)
def test_drivers_layouts_give_their_columns(layout, columns, order) -> None:
    values = np.random.default_rng(1).integers(1, 100, (4, 5, len(layout))).astype(float)
    points = points_of_message(cloud_of(layout, values, order, padding=(7, 3)))
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, values[..., columns].reshape(-1, len(columns)))


@given(
    st.permutations(HESAI), st.integers(1, 4), st.integers(1, 5), st.tuples(st.integers(0, 9), st.integers(0, 9)),
    st.sampled_from("<>"),
)  # fmt: skip
def test_order_of_fields_and_padding_do_not_matter(layout, height, width, padding, order) -> None:
    values = np.arange(1.0, 1.0 + height * width * len(layout)).reshape(height, width, len(layout)) % 200
    names = [name for name, _ in layout]
    chosen = [names.index(name) for name in ("x", "y", "z", "intensity", "ring")]
    np.testing.assert_array_equal(
        points_of_message(cloud_of(layout, values, order, padding)), values[..., chosen].reshape(-1, 5)
    )


def test_points_that_are_not_finite_are_left_out_and_intensities_end_at_255() -> None:
    values = np.array([[[1.0, 2, 3, 400, 7, 0], [np.nan, 0, 0, 0, 0, 0], [4, 5, 6, np.nan, 8, 0]]])
    np.testing.assert_array_equal(points_of_message(cloud_of(VELODYNE, values)), [[1, 2, 3, 255, 7], [4, 5, 6, 0, 8]])


def test_ring_without_intensity_keeps_its_place() -> None:
    layout = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2")]
    points = points_of_message(cloud_of(layout, np.array([[[1.0, 2, 3, 9]]])))
    np.testing.assert_array_equal(points, [[1, 2, 3, 0, 9]])


GOOD = cloud_of(VELODYNE, np.ones((2, 3, 6)))


@pytest.mark.parametrize(
    ("cloud", "words"),
    [
        (replace(GOOD, fields=GOOD.fields[1:]), "no field x among y z intensity ring time"),
        (replace(GOOD, fields=[]), "no field x and y and z among none"),
        (replace(GOOD, fields=[Field("x", 0, 3), *GOOD.fields[1:]]), "field x is of type i2: metres are expected"),
        (replace(GOOD, fields=[Field("x", 0, 7, 3), *GOOD.fields[1:]]), "field x is of type 3 x f4"),
        (replace(GOOD, fields=[*GOOD.fields[:3], Field("ring", 12, 9)]), "field ring is of type datatype 9"),
        (replace(GOOD, fields=[Field("x", 24, 7), *GOOD.fields[1:]]), "field x at 24 lies outside of a point"),
        (replace(GOOD, row_step=20), "a row of 3 points of 22 bytes has 20 bytes"),
        (replace(GOOD, data=GOOD.data[:-1]), "6 points of 22 bytes are announced, 131 bytes follow"),
        (replace(GOOD, width=0), "0 points"),
        (replace(GOOD, width=2**31), "points"),
        (cloud_of(VELODYNE, np.full((1, 9, 6), np.nan_to_num(9000.0))), "are these millimetres"),
        (cloud_of(VELODYNE, np.zeros((1, 9, 6))), "all 9 points are 0 0 0: none is a return"),
        (
            cloud_of(VELODYNE, np.array([[[1.0, 2, 3, 4, 300, 0]]])),
            "ring: whole numbers from 0 to 255 are expected, found 300",
        ),
    ],
)
def test_what_contradicts_itself_is_refused_with_what_was_found(cloud, words) -> None:
    with pytest.raises(FrameError, match=words):
        points_of_message(cloud)


@given(st.binary(max_size=300), st.integers(0, 9), st.integers(0, 9), st.integers(0, 40), st.integers(0, 90))
def test_nonsense_is_refused_and_never_raises_anything_else(data, height, width, point_step, row_step) -> None:
    cloud = replace(GOOD, height=height, width=width, point_step=point_step, row_step=row_step, data=data)
    try:
        points = points_of_message(cloud)
    except FrameError:
        return
    assert len(points) <= height * width
