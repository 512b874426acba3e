"""Numbers in an Ouster's metadata: what no sensor has is refused with its key, what sensors have is taken."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.config import ConfigError
from common.source_url import SourceUrl
from services.infra_lidar.input.calibration_files import read_ouster
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.ouster_metadata import MetadataError
from tests.infra_lidar.made_packets import metadata

COLUMNS, BEAMS = 1024, 32
DOWN, EVEN = list(range(16, -16, -1)), [0.0] * BEAMS
LEVEL = np.eye(4).ravel().tolist()


def with_window(window: Any) -> str:
    layout = {"columns_per_frame": COLUMNS, "columns_per_packet": 16, "pixels_per_column": BEAMS}
    return sensor(data_format=layout | {"column_window": window})


def sensor(**change: Any) -> str:
    angles = {"beam_altitude_angles": DOWN, "beam_azimuth_angles": EVEN}
    return metadata(columns=COLUMNS, beams=BEAMS, **(angles | change))


def transform(scale: float = 1.0, shift: tuple[float, float, float] = (0.0, 0.0, 36.18), last: float = 1.0) -> Any:
    matrix = np.diag([-scale, -scale, scale, last])
    matrix[:3, 3] = shift
    return matrix.ravel().tolist()


MIRROR = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            sensor(beam_altitude_angles=[1.0] * BEAMS),
            "beam_altitude_angles: from 1 to 1: expected degrees that span 3 ",
        ),
        (sensor(beam_altitude_angles=[math.radians(one) for one in DOWN]), "from -0.261799 to 0.279253: .* radians?"),
        (sensor(beam_altitude_angles=[math.nan, *DOWN[1:]]), "altitude_angles: expected .* -95 to 95, found nan"),
        (sensor(beam_altitude_angles=[400.0] * BEAMS), "beam_altitude_angles: expected .* -95 to 95, found 400"),
        (sensor(beam_altitude_angles=[1.0] * 31), "pixels_per_column 32, but 31 beam_altitude_angles and 32 beam_az"),
        (sensor(beam_azimuth_angles=[math.inf] * BEAMS), "beam_azimuth_angles: expected .* -180 to 180, found inf"),
        (sensor(beam_azimuth_angles=[270.0] * BEAMS), "beam_azimuth_angles: expected .* -180 to 180, found 270"),
        (sensor(lidar_origin_to_beam_origin_mm=1e9), "beam_origin_mm: expected mm from 0 to 100, found 1e"),
        (sensor(lidar_origin_to_beam_origin_mm=-1.0), "beam_origin_mm: expected mm from 0 to 100, found -1"),
        (sensor(lidar_to_sensor_transform=[0.0] * 16), "lidar_to_sensor_transform: .* the last four 0 0 0 1; found"),
        (sensor(lidar_to_sensor_transform=transform(shift=(0.0, 0.0, math.nan))), "transform: expected finite numbers"),
        (sensor(lidar_to_sensor_transform=transform(scale=1000.0)), "transform: expected a rotation"),
        (sensor(lidar_to_sensor_transform=MIRROR), "transform: expected a rotation"),
        (sensor(lidar_to_sensor_transform=transform(last=2.0)), "the last four 0 0 0 1"),
        (sensor(lidar_to_sensor_transform=transform(shift=(0.0, 0.0, 36180.0))), "shift: expected mm .* found 36180"),
        (sensor(lidar_to_sensor_transform=transform(shift=(5.0, 0.0, 0.0))), "a rotation about z and a shift along it"),
        (with_window([5000, 1]), r"column_window: expected two columns from 0 to 1023, found \[5000, 1\]"),
        (with_window([0, 1024]), "column_window: expected two columns from 0 to 1023"),
        (with_window([-1, 1023]), "column_window: expected two columns"),
        (with_window([0]), "column_window: expected two columns"),
        (with_window("all"), "column_window: expected two columns"),
    ],
)
def test_numbers_that_no_sensor_has_are_refused(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(MetadataError, match=words):
        OusterFormat(text)
    file = tmp_path / "sensor.json"
    file.write_text(text)
    with pytest.raises(ConfigError, match=rf"sensor\.json: .*{words}"):
        read_ouster(file, SourceUrl("file", "a.pcap"))


@pytest.mark.parametrize(
    ("highest_deg", "lowest_deg", "beside_deg", "origin_mm", "height_mm"),
    [
        (45.75, -46.26, 11.35, 27.67, 36.18),  # OS0, firmware 2.3
        (43.9, -46.2, 11.15, 0.0, 36.18),  # OS0, firmware 1.14: says nothing of the origin
        (16.509, -16.858, 3.4, 0.0, 36.18),  # OS1, firmware 1.12
        (20.47, -21.95, 4.25, 16.721, 38.195),  # OS1, firmware 3.0
        (12.75, -15.32, 4.27, 15.806, 36.18),  # OS1 with a gradient of beams, firmware 2.1
        (10.87, -10.48, 2.11, 13.762, 74.296),  # OS2, firmware 2.0
        (90.3, -0.2, 25.0, 28.0, 40.0),  # as an OSDome looks
        (22.5, 0.0, 4.2, 15.806, 36.18),  # beams above the horizon
    ],
)
def test_what_sensors_say_is_taken(
    highest_deg: float, lowest_deg: float, beside_deg: float, origin_mm: float, height_mm: float
) -> None:
    OusterFormat(
        sensor(
            beam_altitude_angles=np.linspace(highest_deg, lowest_deg, BEAMS).tolist(),
            beam_azimuth_angles=[beside_deg, -beside_deg] * (BEAMS // 2),
            lidar_origin_to_beam_origin_mm=origin_mm,
            lidar_to_sensor_transform=transform(shift=(0.0, 0.0, height_mm)),
        )
    )


@pytest.mark.parametrize("window", [[0, 1023], [2, 1], [900, 100], None])
def test_windows_are_taken_over_the_seam_too(window: Any) -> None:
    OusterFormat(with_window(window))
