"""``look`` of the roadside lidar: revolution rate, returns, losses. Needs none of the pipeline's kernels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer

from common.bus.look import AsJson, Look, PeriodSamples, Seconds, Watch, collect, show
from common.bus.service_app import load_config
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.models import KINDS, compile_decoder
from services.infra_lidar.input.packets import Frame
from services.infra_lidar.input.senders import print_senders
from services.infra_lidar.input.source import open_source

SENSORS = {"velodyne": "VLS-128", "ouster": "Ouster", "hesai": "Hesai", "robosense": "RoboSense"}


def looks(config: InfraLidarConfig, seconds: float) -> Iterator[Look]:
    """One ``Look`` per period, over the revolutions that came in it.

    Raises:
        ConfigError: the source cannot be opened as it is written.
    """
    kind = config.source.partition(":")[0]
    if kind in KINDS:
        compile_decoder(kind)  # takes seconds on the first run; packets would be lost meanwhile
    sensor = SENSORS.get(kind, "")
    for seen in collect(lambda report: open_source(config, report), seconds):
        yield describe(seen, sensor) if seen.items else seen.nothing("complete revolution")


def describe(seen: PeriodSamples[tuple[int, Frame]], sensor: str) -> Look:
    """The figures of one period, with the returns of the newest revolution. Empty cells are not counted."""
    points, packets = seen.items[-1][1].points, len(seen.items[-1][1].packets)
    which = f"{sensor}, {packets} packets per revolution, " if sensor else ""
    reach_m = np.linalg.norm(points[:, :3], axis=1)
    reach_m = reach_m[np.isfinite(reach_m) & (reach_m > 0.0)]  # empty cells of an image, or of a driver's cloud
    where = f", from {reach_m.min():.1f} to {reach_m.max():.1f} m" if len(reach_m) else ""
    bad = ", ".join(f"{name}: {count}" for name, count in sorted(seen.status.counters.items()))
    rate = f"{seen.rate_hz:.1f} revolutions per second"
    what = f"{which}{rate}, {len(reach_m)} returns{where}{'; ' + bad if bad else ''}"
    if len(reach_m):
        return Look(sees=True, what=what)
    return Look(sees=False, what=what, do="revolutions without a return: is the window covered, the laser on?")


def add_look(app: typer.Typer) -> None:
    """Give the command line the subcommand ``look``, here with a capture or a UDP port to look at."""

    @app.command()
    def look(
        context: typer.Context,
        where: Annotated[
            str | None,
            typer.Argument(
                metavar="FILE_OR_PORT", help="A capture, a ROS bag, files of points, or a UDP port such as 2368."
            ),
        ] = None,
        seconds: Seconds = 1.0,
        watch: Watch = False,
        as_json: AsJson = False,
    ) -> None:
        """Open the source and say what the sensor shows; or say which lidars send in FILE_OR_PORT.

        For each: address, model, rate, returns, losses, and the `source` to configure. Exit code 1 when there is
        nothing.
        """
        if where is not None:
            raise typer.Exit(0 if print_senders(where, seconds) else 1)
        config = load_config(InfraLidarConfig, *context.obj)
        show(config, looks(config, seconds), watch, as_json)
