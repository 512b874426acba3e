"""The map on the Earth against published examples, and there and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.geodesy import MapOrigin, compass_deg, geocentric, geodetic, map_to_wgs84, wgs84_to_map

# EPSG Guidance Note 7-2, examples of methods 9602 (geographic to geocentric) and 9837 (geographic to topocentric).
EPSG_PLACE = np.array([[53 + 48 / 60 + 33.820 / 3600, 2 + 7 / 60 + 46.380 / 3600, 73.0]])
EPSG_GEOCENTRIC = [3_771_793.968, 140_253.342, 5_124_304.349]
EPSG_TOPOCENTRIC = [-189_013.869, -128_642.040, -4_220.171]  # east, north, up of latitude 55, longitude 5, height 200 m


def origin(latitude_deg: float, longitude_deg: float, altitude_m: float = 0.0, heading_deg: float = 90.0) -> MapOrigin:
    return MapOrigin(
        latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=altitude_m, heading_deg=heading_deg
    )


def assert_place(found: np.ndarray, published: np.ndarray) -> None:
    """Within the rounding of the published figures, a millimetre."""
    assert (np.abs(found - published) < [1e-8, 2e-8, 1e-3]).all()


def test_the_published_geocentric_example() -> None:
    np.testing.assert_allclose(geocentric(EPSG_PLACE)[0], EPSG_GEOCENTRIC, atol=1e-3)
    assert_place(geodetic(np.array([EPSG_GEOCENTRIC]))[0], EPSG_PLACE[0])


def test_the_published_topocentric_example() -> None:
    """With the x axis to the east, the map is the topocentric frame."""
    np.testing.assert_allclose(wgs84_to_map(origin(55, 5, 200), EPSG_PLACE)[0], EPSG_TOPOCENTRIC, atol=1e-3)
    assert_place(map_to_wgs84(origin(55, 5, 200), np.array([EPSG_TOPOCENTRIC]))[0], EPSG_PLACE[0])


def test_a_second_published_example() -> None:
    """Latitude 42, longitude -82, height 200 m in the documentation of MATLAB's enu2geodetic and of pymap3d."""
    place = map_to_wgs84(origin(42, -82, 200), np.array([[186.277521, 286.842228, 939.692621]]))[0]
    assert_place(place, np.array([42.00258197, -81.99775196, 1139.7018]))


@pytest.mark.parametrize(
    ("heading_deg", "grows", "falls"), [(90.0, 1, None), (0.0, 0, None), (180.0, None, 0), (-90.0, None, 1)]
)
def test_the_heading_is_that_of_the_x_axis(heading_deg: float, grows: int | None, falls: int | None) -> None:
    start, end = map_to_wgs84(origin(52.0, 13.0, 40.0, heading_deg), np.array([[0, 0, 0], [100.0, 0, 0]]))
    step = end - start
    other = 0 if (grows if grows is not None else falls) == 1 else 1
    assert abs(step[other]) < 1e-7
    assert step[grows] > 1e-4 if grows is not None else step[falls or 0] < -1e-4
    assert compass_deg(origin(52.0, 13.0, 40.0, heading_deg), 0.0) == heading_deg % 360.0


def test_left_of_east_is_north() -> None:
    assert compass_deg(origin(52.0, 13.0), np.pi / 2) == pytest.approx(0.0)
    assert compass_deg(origin(52.0, 13.0), -np.pi / 2) == pytest.approx(180.0)


@settings(max_examples=200, deadline=None)
@given(
    latitude=st.floats(-89.9, 89.9), longitude=st.floats(-180, 180), altitude=st.floats(-400, 8000),
    heading=st.floats(-360, 360),
    point=st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-50, 50)),
)  # fmt: skip
def test_there_and_back(
    latitude: float, longitude: float, altitude: float, heading: float, point: tuple[float, float, float]
) -> None:
    here = origin(latitude, longitude, altitude, heading)
    np.testing.assert_allclose(wgs84_to_map(here, map_to_wgs84(here, np.array([point])))[0], point, atol=1e-6)
