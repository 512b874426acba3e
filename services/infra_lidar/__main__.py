"""spotter-infra-lidar: tracked road users from a 128-beam lidar on a pole."""

from __future__ import annotations

import gc
import logging

import msgspec

from common.bus.raw_tap import RawTap, changes
from common.bus.runtime import Service
from common.bus.service_app import run_app, service_app
from common.bus.status import Report
from common.topics import INFRA_CLUSTERS, INFRA_POINTS, INFRA_RAW, INFRA_TRACKS
from services.infra_lidar.adaptation.command import adapt
from services.infra_lidar.calibration.command import RecalibrationRequest, recalibrate
from services.infra_lidar.calibration.store import Store
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.raw import publish_raw
from services.infra_lidar.input.source import open_source, surveyed_pose
from services.infra_lidar.look import add_look
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.training.commands import add_commands
from services.infra_lidar.warm_up import warm_up

log = logging.getLogger(__name__)


def run(config: InfraLidarConfig) -> bool:
    """Process frames until interrupted or until the source ends. Returns whether the service closed cleanly."""
    open_source(config, Report("infra_lidar"))  # a wrong source stops here, before anything is waited for
    configured, config = config, msgspec.structs.replace(config, T_map_sensor=surveyed_pose(config))
    store = Store(config.calibration.store)
    calibration, background = store.load()
    pipeline = InfraLidarPipeline(config, calibration, background)
    with Service("infra_lidar", config) as service:
        frames = open_source(config, service.report)
        warm_up(config, lambda text: service.report.state("starting", text))
        gc.freeze()  # Numba keeps about a million objects; a full garbage collection takes 0.1 s
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
            publish_raw(raw, stamp_ns, frame)
            store.keep(pipeline.calibration.settled_calibration, pipeline.scene.background.model)
        log.info("the source has ended")
    return service.closed_cleanly


app = service_app("infra_lidar", InfraLidarConfig, run, __doc__)
app.command()(recalibrate)
app.command()(adapt)
add_look(app)
add_commands(app)


def main() -> None:
    """The console command ``spotter-infra-lidar``."""
    run_app(app, "plot")


if __name__ == "__main__":
    main()
