"""What a person at the bench wants from ``spotter-radar`` besides running it: a picture, and a recording.

``spotter-radar --plot out.png`` looks at some frames without the network and draws the last one;
``spotter-radar --record out.radar`` writes raw frames to a file that ``--source file:out.radar`` plays again.
"""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path
from typing import Annotated

import typer

from common.bus.service_app import check_output, errors_in_one_line, load_config, setup_logging
from common.bus.status import Report
from common.config import ConfigError
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.plot import draw
from services.radar_pi.recording import Recorder
from services.radar_pi.source import open_source, with_waveform_of_source

Frames = Annotated[int, typer.Option("--frames", min=1, help="How many frames to take from the source.")]


def add_tools(app: typer.Typer) -> None:
    """Give the service's command line the subcommands ``plot`` and ``record``."""

    @app.command()
    def plot(
        context: typer.Context,
        picture: Annotated[Path, typer.Argument(metavar="FILE", help="The PNG to write.")],
        frames: Frames = 40,
    ) -> None:
        """Draw the last of some frames, with the tracks' past, to a PNG. `--plot FILE` is the same."""
        setup_logging("radar")
        with errors_in_one_line():
            count = plot_frames(load_config(RadarConfig, *context.obj), picture, frames)
            typer.echo(f"{picture}: the last of {count} frames")

    @app.command()
    def record(
        context: typer.Context,
        recording: Annotated[Path, typer.Argument(metavar="FILE", help="The .radar file to write.")],
        frames: Frames = 40,
    ) -> None:
        """Write the raw frames of the source to a .radar file. `--record FILE` is the same."""
        setup_logging("radar")
        with errors_in_one_line():
            typer.echo(
                f"{recording}: {record_frames(load_config(RadarConfig, *context.obj), recording, frames)} frames"
            )


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

    What is written stays readable when this is interrupted; an older file of that name is kept until a frame comes.

    Raises:
        ConfigError: not one frame came, the file cannot be written there, or it is the source itself.
    """
    check_output(path)
    _check_not_the_source(config.source, path)
    config = with_waveform_of_source(config)
    source, count = open_source(config, Report("record")), 0
    first = next(source, None)
    if first is None:
        raise ConfigError(f"source {config.source}: not one frame came; {path} is not written")
    with Recorder(path, config.waveform) as recorder:
        for frame in islice(chain([first], source), frames):
            recorder.write(frame.stamp_ns, frame.received_ns, frame.samples)
            count += 1
    return count


def _check_not_the_source(source: str, path: Path) -> None:
    """Opening a file for writing empties it, also the one that is being read."""
    read = Path(source.partition(":")[2].partition("?")[0])
    if path.exists() and read.exists() and path.samefile(read):
        raise ConfigError(f"source {source}: expected another file to record to, {path} is the source itself")
