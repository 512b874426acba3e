"""What is nearest right now, by each sensor of its own.

python examples/nearest_obstacle.py [ENDPOINT]
"""

from __future__ import annotations

import sys

from spotter_client import CameraDetections, LidarZones, RadarTracks, connect


def main(endpoint: str = "tcp/127.0.0.1:7447") -> dict[str, float | None]:
    """Print and return the nearest distance (m) by sensor; None = nothing seen."""
    with connect(endpoint) as bus:
        zones = bus.latest("jetson0/lidar/zones", LidarZones)
        radar = bus.latest("pi0/radar/tracks", RadarTracks)
        camera = bus.latest("jetson0/camera/detections", CameraDetections)
    lanes_m = [zone.nearest_m for zone in (zones.left, zones.centre, zones.right)]
    nearest_m = {
        "lidar": min((m for m in lanes_m if m is not None), default=None),
        "radar": min((track.range_m for track in radar.tracks), default=None),
        "camera": min((found.distance_m for found in camera.detections), default=None),
    }
    for name, distance_m in nearest_m.items():
        sys.stdout.write(f"{name:<8} {'nothing' if distance_m is None else f'{distance_m:.2f} m'}\n")
    return nearest_m


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except KeyboardInterrupt:
        pass
    except ConnectionError as error:  # no router answers
        sys.exit(str(error))
