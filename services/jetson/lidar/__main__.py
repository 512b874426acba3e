"""LD06 lidar service: revolutions of a 2-D lidar -> what stands in the three lanes ahead."""

from __future__ import annotations

from common.clock import monotonic_s
from common.launch import service_app
from common.runtime import Service
from common.topics import LIDAR_SCAN, LIDAR_ZONES
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.filters import Fate
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.source import open_source


def run(config: LidarConfig) -> bool:
    pipeline = LidarPipeline(config)
    with Service("lidar", config) as service:
        publish_zones, publish_scan = service.publisher(LIDAR_ZONES), service.publisher(LIDAR_SCAN)
        for stamp_ns, scan in open_source(config, service.report):
            begin_s = monotonic_s()
            zones = pipeline.process(stamp_ns, scan)
            zones.stage_ms = {"zones": (monotonic_s() - begin_s) * 1e3}
            publish_zones(zones)
            scan.used = (pipeline.fate == Fate.USED).astype("uint8")
            scan.state, scan.reason = zones.state, zones.reason
            publish_scan(scan)
    return service.closed_cleanly


app = service_app("lidar", LidarConfig, run, __doc__)


def main() -> None:
    app()


if __name__ == "__main__":
    main()
