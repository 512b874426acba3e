"""What a person at the bench wants from ``spotter-radar`` besides running it: a picture, and a recording.

``spotter-radar --plot out.png`` looks at some frames without the network and draws the last one;
``spotter-radar --record out.radar`` writes raw frames to a file that ``--source file:out.radar`` plays again.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import typer

from common.bus.service_app import (
    ConfigOption,
    SetOption,
    SourceOption,
    check_output,
    load_config,
    setup_logging,
    told_in_a_line,
)
from common.bus.status import Report
from common.config import ConfigError
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.plot import draw
from services.radar_pi.recording import Recorder
from services.radar_pi.source import open_source, with_waveform_of_source

PlotOption = Annotated[Path | None, typer.Option("--plot", help="Draw what the radar sees to a PNG and stop.")]
RecordOption = Annotated[Path | None, typer.Option("--record", help="Write raw frames to a .radar file and stop.")]
FramesOption = Annotated[int, typer.Option("--frames", min=1, help="How many frames to plot or record from.")]


def add_tools(app: typer.Typer) -> None:
    """Give the service's command line the options --plot, --record and --frames."""
    service: Any = app.registered_callback
    start = service.callback

    @app.callback(invoke_without_command=True, help=app.info.help)
    def start_or_tool(
        context: typer.Context,
        config: ConfigOption = None,
        overrides: SetOption = None,
        source: SourceOption = None,
        show_config: Annotated[
            bool, typer.Option("--show-config", help="Print the effective configuration and stop.")
        ] = False,
        plot: PlotOption = None,
        record: RecordOption = None,
        frames: FramesOption = 40,
    ) -> None:
        if plot is None and record is None:
            start(context, config, overrides, source, show_config)
            return
        setup_logging("radar")
        effective = load_config(RadarConfig, config, overrides, source)
        with told_in_a_line():
            if record is not None:
                typer.echo(f"{record}: {record_frames(effective, record, frames)} frames")
            if plot is not None:
                typer.echo(f"{plot}: the last of {plot_frames(effective, plot, frames)} frames")


def plot_frames(config: RadarConfig, path: Path, frames: int) -> int:
    """Process so many frames of the source and draw the last one with the tracks' past; returns how many there were."""
    check_output(path, ".png", ".svg", ".pdf")
    config = with_waveform_of_source(config)
    pipeline = RadarPipeline(config)
    source = open_source(config, Report("plot"))
    history = [
        pipeline.process(frame.stamp_ns, frame.samples, None, frame.epoch, frame.note)
        for frame in islice(source, frames)
    ]
    if not history:
        raise ConfigError(f"source {config.source}: not one frame came; {path} is not drawn")
    draw(path, pipeline.detections(), history)
    return len(history)


def record_frames(config: RadarConfig, path: Path, frames: int) -> int:
    """Write so many frames of the source to a file; returns how many there were.

    What is written stays readable when this is interrupted.
    """
    check_output(path)
    config = with_waveform_of_source(config)
    source, count = open_source(config, Report("record")), 0
    with Recorder(path, config.waveform) as recorder:
        for frame in islice(source, frames):
            recorder.write(frame.stamp_ns, frame.received_ns, frame.samples)
            count += 1
    return count
