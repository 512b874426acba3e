"""What a person at the bench wants from ``spotter-radar`` besides running it: a picture, and a recording.

``spotter-radar --plot out.png`` looks at some frames without the network and draws the last one;
``spotter-radar --record out.radar`` writes raw frames to a file that ``--source file:out.radar`` plays again.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import typer

from common.bus.service_app import ConfigOption, SetOption, SourceOption, load_config, setup_logging
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
        try:
            if record is not None:
                record_frames(effective, record, frames)
            if plot is not None:
                plot_frames(effective, plot, frames)
        except ConfigError as error:
            typer.echo(f"spotter: {error}", err=True)
            raise typer.Exit(2) from None


def plot_frames(config: RadarConfig, path: Path, frames: int) -> None:
    """Process so many frames of the source and draw the last one with the tracks' past."""
    config = with_waveform_of_source(config)
    pipeline = RadarPipeline(config)
    source = open_source(config, Report("plot"))
    history = [
        pipeline.process(frame.stamp_ns, frame.samples, None, frame.epoch, frame.note)
        for frame in islice(source, frames)
    ]
    draw(path, pipeline.detections(), history)


def record_frames(config: RadarConfig, path: Path, frames: int) -> None:
    """Write so many frames of the source to a file; what is written stays readable when this is interrupted."""
    config = with_waveform_of_source(config)
    with Recorder(path, config.waveform) as recorder:
        for frame in islice(open_source(config, Report("record")), frames):
            recorder.write(frame.stamp_ns, frame.received_ns, frame.samples)
