"""The roadside's own results again, from a recording: for ``spotter replay --verify --service infra_lidar``."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from common.bus.status import Report
from common.messages import ObjectTracks
from services.infra_lidar.calibration.store import Store
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.source import open_source, surveyed_pose
from services.infra_lidar.pipeline import InfraLidarPipeline


def reprocess(config: InfraLidarConfig, report: Report) -> Iterator[ObjectTracks]:
    """Every message that the service would publish on ``infra_lidar/tracks``, without a bus."""
    config = msgspec.structs.replace(config, T_map_sensor=surveyed_pose(config))
    pipeline = InfraLidarPipeline(config, *Store(config.calibration.store).load())
    for stamp_ns, frame in open_source(config, report):
        yield pipeline.process(stamp_ns, frame.returns, frame.quality, frame.received_ns).tracks
