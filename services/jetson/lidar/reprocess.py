"""The lidar's own results again, from a recording of its bytes: for ``spotter replay --verify --service lidar``."""

from __future__ import annotations

from collections.abc import Iterator

from common.bus.status import Report
from common.messages import LidarZones
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.source import open_source


def reprocess(config: LidarConfig, report: Report) -> Iterator[LidarZones]:
    """Every message that the service would publish on ``lidar/zones``, without a bus."""
    pipeline = LidarPipeline(config)
    for stamp_ns, scan in open_source(config, report):
        yield pipeline.process(stamp_ns, scan, scan.motion)
