"""spotter-infra-lidar: tracked road users from a 128-beam lidar on a pole."""

from __future__ import annotations

import gc
import logging
import sys

import msgspec

from common.config import ConfigError
from common.launch import flag_as_command, service_app
from common.raw import RawTap, changes
from common.runtime import Service
from common.topics import INFRA_CLUSTERS, INFRA_POINTS, INFRA_RAW, INFRA_TRACKS
from services.infra_lidar.commands import add_commands
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.raw import hand_over
from services.infra_lidar.recalibrate import RecalibrationRequest, recalibrate
from services.infra_lidar.source import open_source, surveyed_pose
from services.infra_lidar.store import Store
from services.infra_lidar.warm_up import warm_up

log = logging.getLogger(__name__)


def run(config: InfraLidarConfig) -> bool:
    """Work until interrupted or until the source ends."""
    configured, config = config, msgspec.structs.replace(config, T_map_sensor=surveyed_pose(config))
    store = Store(config.calibration.store)
    calibration, background = store.load()
    pipeline = InfraLidarPipeline(config, calibration, background)
    with Service("infra_lidar", config) as service:
        frames = open_source(config, service.report)
        warm_up(config, lambda text: service.report.state("starting", text), learned=background is not None)
        gc.freeze()  # a million objects of the compiler stay for good; to look for garbage among them costs 0.1 s
        request = RecalibrationRequest(service)
        publish_tracks = service.publisher(INFRA_TRACKS)
        publish_clusters = service.publisher(INFRA_CLUSTERS)
        publish_points = service.publisher(INFRA_POINTS)
        raw = RawTap(service.publisher(INFRA_RAW), fitted=changes(configured, config))
        for stamp_ns, frame in frames:
            if request.taken():
                pipeline.recalibrate()
            result = pipeline.process(stamp_ns, frame.returns, frame.quality, frame.received_ns)
            publish_tracks(result.tracks)
            if publish_clusters.wanted:
                publish_clusters(result.clusters_message())
            if publish_points.wanted:
                publish_points(result.points_message(config.points_limit))
            hand_over(raw, stamp_ns, frame)
            store.keep(pipeline)
        log.info("the source has ended")
    return service.closed_cleanly


app = service_app("infra_lidar", InfraLidarConfig, run, __doc__)
app.command()(recalibrate)
add_commands(app)


def main() -> None:
    """Console entry point."""
    try:
        app(args=flag_as_command(sys.argv[1:], "plot"))
    except ConfigError as error:  # of a subcommand
        sys.stderr.write(f"spotter: {error}\n")
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
