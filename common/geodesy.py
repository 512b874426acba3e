"""Position of the site's map on the Earth: map coordinates to WGS84 latitude, longitude and height. Pure.

By way of the Earth-centred frame (EPSG Guidance Note 7-2, methods 9602 and 9837), without a projection: exact wherever
the map's plane is the plane that touches the ellipsoid at the origin.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from common.config import Section

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257_223_563
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)
SEMI_MINOR_M = SEMI_MAJOR_M * (1.0 - FLATTENING)
NO_ORIGIN = "where the map lies is not known: give [map] latitude_deg, longitude_deg and heading_deg in the site file"


class MapOrigin(Section, frozen=True, kw_only=True):
    """Where the origin of the map lies on the WGS84 ellipsoid, and where its x axis points."""

    latitude_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    altitude_m: Annotated[float, Meta(ge=-500.0, le=9000.0)] = 0.0  # above the ellipsoid, not above the sea
    heading_deg: Annotated[float, Meta(ge=-360.0, le=360.0)]  # of the map's x axis, clockwise from true north


def map_to_wgs84(origin: MapOrigin, points_m: np.ndarray) -> np.ndarray:
    """(N, 3) latitude and longitude in degrees and height in metres, of points (N, 3) in the map frame."""
    place = np.array([origin.latitude_deg, origin.longitude_deg, origin.altitude_m])
    east_north_up = np.asarray(points_m, float).reshape(-1, 3) @ _R_enu_map(origin).T
    return geodetic(geocentric(place[None]) + east_north_up @ _R_earth_enu(place).T)


def wgs84_to_map(origin: MapOrigin, places: np.ndarray) -> np.ndarray:
    """(N, 3) metres in the map frame, of places (N, 3) latitude, longitude in degrees and height in metres."""
    place = np.array([origin.latitude_deg, origin.longitude_deg, origin.altitude_m])
    return (geocentric(places) - geocentric(place[None])) @ _R_earth_enu(place) @ _R_enu_map(origin)


def compass_deg(origin: MapOrigin, yaw_rad: float) -> float:
    """Clockwise from true north at the origin, 0 to 360, of a direction in the map."""
    return float((origin.heading_deg - np.degrees(yaw_rad)) % 360.0)


def geocentric(places: np.ndarray) -> np.ndarray:
    """(N, 3) Earth-centred x, y, z in metres, of places (N, 3) latitude, longitude in degrees and height in metres."""
    latitude, longitude = np.radians(places[:, 0]), np.radians(places[:, 1])
    across = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_2 * np.sin(latitude) ** 2)  # radius in the prime vertical
    flat = (across + places[:, 2]) * np.cos(latitude)
    up = ((1.0 - ECCENTRICITY_2) * across + places[:, 2]) * np.sin(latitude)
    return np.stack([flat * np.cos(longitude), flat * np.sin(longitude), up], axis=1)


def geodetic(earth_m: np.ndarray) -> np.ndarray:
    """(N, 3) latitude, longitude in degrees and height in metres, of Earth-centred x, y, z (N, 3).

    Bowring (1976) with his formula of 1985 for the height: under a micrometre for heights up to 10 km.
    """
    x, y, z = earth_m.T
    flat = np.hypot(x, y)
    reduced = np.arctan2(z * SEMI_MAJOR_M, flat * SEMI_MINOR_M)
    second_2 = ECCENTRICITY_2 / (1.0 - ECCENTRICITY_2)
    latitude = np.arctan2(
        z + second_2 * SEMI_MINOR_M * np.sin(reduced) ** 3, flat - ECCENTRICITY_2 * SEMI_MAJOR_M * np.cos(reduced) ** 3
    )
    root = np.sqrt(1.0 - ECCENTRICITY_2 * np.sin(latitude) ** 2)
    height = flat * np.cos(latitude) + z * np.sin(latitude) - SEMI_MAJOR_M * root
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height], axis=1)


def _R_earth_enu(place: np.ndarray) -> np.ndarray:
    """(3, 3) from east, north, up at a place to the Earth-centred frame."""
    latitude, longitude = np.radians(place[:2])
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    east = [-sin_lon, cos_lon, 0.0]
    north = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]
    return np.array([east, north, [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat]]).T


def _R_enu_map(origin: MapOrigin) -> np.ndarray:
    """(3, 3) from the map to east, north, up: its x axis points to the heading, y to the left of it."""
    heading = np.radians(origin.heading_deg)
    sin, cos = np.sin(heading), np.cos(heading)
    return np.array([[sin, -cos, 0.0], [cos, sin, 0.0], [0.0, 0.0, 1.0]])
