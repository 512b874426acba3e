"""LD06 lidar service: revolutions of a 2-D lidar -> what stands in the three lanes ahead."""

from __future__ import annotations

from pathlib import Path

import typer

from common.bus.ego import EgoWatch
from common.bus.look import add_look
from common.bus.raw_tap import RawTap
from common.bus.runtime import Service
from common.bus.service_app import errors_in_one_line, load_config, run_app, service_app
from common.bus.status import Report
from common.clock import monotonic_s
from common.messages import EgoMotion
from common.topics import EGO_MOTION, LIDAR_RAW, LIDAR_SCAN, LIDAR_ZONES
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.filters import RejectReason
from services.jetson.lidar.look import looks
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.source import open_source


def run(config: LidarConfig) -> bool:
    """Publish zones and scan of each revolution until the source or the process ends; False if not closed cleanly."""
    open_source(config, Report("lidar"))  # a wrong source stops here, before a router is waited for
    pipeline = LidarPipeline(config)
    with Service("lidar", config) as service:
        publish_zones, publish_scan = service.publisher(LIDAR_ZONES), service.publisher(LIDAR_SCAN)
        raw = RawTap(service.publisher(LIDAR_RAW))
        ego = EgoWatch(service.latest(EGO_MOTION, EgoMotion, config.ego_host), config.path)
        for stamp_ns, scan in open_source(config, service.report, raw):
            begin_s = monotonic_s()
            if not config.source.startswith("mcap:"):
                scan.motion = ego.now()
            raw.about["motion"] = scan.motion  # with the piece that closed this scan, which is sent after it
            zones = pipeline.process(stamp_ns, scan, scan.motion)
            zones.stage_ms = {"zones": (monotonic_s() - begin_s) * 1e3}
            publish_zones(zones)  # first: somebody decides on it
            scan.used = (pipeline.reject_reason == RejectReason.USED).astype("uint8")
            scan.state, scan.reason = zones.state, zones.reason
            publish_scan(scan)
    return service.closed_cleanly


app = service_app("lidar", LidarConfig, run, __doc__)
add_look(app, LidarConfig, looks)


@app.command()
def plot(
    context: typer.Context,
    picture: Path,
    scans: int = typer.Option(20, min=1, help="How many revolutions to look at; the last one is drawn."),
) -> None:
    """Draw scan, lanes, zones and rejected points into a PNG file. `--plot FILE` is the same."""
    from services.jetson.lidar.plot import plot_scans

    with errors_in_one_line():
        count = plot_scans(load_config(LidarConfig, *context.obj), picture, scans)
        typer.echo(f"{picture}: the last of {count} turns")


def main() -> None:
    """The console command ``spotter-lidar``."""
    run_app(app, "plot")


if __name__ == "__main__":
    main()
