"""``spotter-camera snap``: stills for the calibration, as the service gets them: upright, full size, nothing drawn."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from common.bus.look import collect
from common.bus.service_app import end_process, load_config
from common.bus.status import Report
from common.config import ConfigError
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.frames import Frame, RateLimit
from services.jetson.camera.source import open_source
from services.jetson.camera.training.calibrate import LEAST_CORNERS, find_board
from services.jetson.camera.training.coverage import FIELDS, corners_by_field, uncovered


def snap(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(help="Where the pictures go; they are numbered on.")] = Path("board"),
    count: Annotated[int, typer.Option(min=1, max=1000, help="How many pictures.")] = 12,
    every_s: Annotated[float, typer.Option("--every", min=0.1, max=60.0, help="Seconds between two.")] = 2.0,
    columns: Annotated[int, typer.Option(min=LEAST_CORNERS, help="Inner corners along a row of the board.")] = 9,
    rows: Annotated[int, typer.Option(min=LEAST_CORNERS, help="Inner corners along a column.")] = 6,
) -> None:
    """Take pictures for `calibrate`, one every two seconds, and say of each whether the board is in it.

    The service must not run: a camera has one reader.
    """
    settings, overrides, source = context.obj
    no_network = [*(overrides or []), "detector.model=none"]  # none is needed to take pictures
    config = load_config(CameraConfig, settings, no_network, source)
    logging.getLogger().addHandler(logging.NullHandler())  # the line below says it
    code = 0
    try:
        with_board = take(config, folder, (count, every_s), (columns, rows))
        sys.stdout.write(f"{with_board} of {count} pictures show the board of {columns} x {rows} corners\n")
    except ConfigError as error:
        sys.stderr.write(f"spotter: {error}\n")
        code = 2
    except (OSError, ValueError) as error:
        sys.stderr.write(f"spotter: {str(error).removeprefix(f'{config.source}: ')}\n")
        code = 1
    except KeyboardInterrupt:
        pass
    end_process(code)  # the thread that waits for a device has nothing to clear up


def take(config: CameraConfig, folder: Path, plan: tuple[int, float], board: tuple[int, int]) -> int:
    """Write the pictures; how many show the board."""
    count, every_s = plan
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for number, image in enumerate(_stills(config, every_s), start=1):
        path = _next_free(folder)
        if not cv2.imwrite(str(path), image):
            raise OSError(f"{path} cannot be written")
        height_px, width_px = image.shape[:2]
        seen = find_board(image, *board)
        found += [seen] if seen is not None else []
        covered = FIELDS**2 - len(uncovered(corners_by_field(found, width_px, height_px)))
        words = f"board, {covered} of {FIELDS**2} parts of the picture so far" if seen is not None else "no board"
        sys.stdout.write(f"{path}  {width_px} x {height_px}  {words}\n")
        sys.stdout.flush()
        if number == count:
            break
    return len(found)


def _stills(config: CameraConfig, every_s: float) -> Iterator[np.ndarray]:
    """A picture of each period, until the source ends.

    Raises:
        OSError: no picture comes; says why.
    """
    due, came = RateLimit(1.0 / every_s), False

    def frames(report: Report) -> Iterator[Frame]:
        source, _ = open_source(config, report)
        yield from (frame for frame in source(threading.Event()) if due(frame.stamp_ns))

    for seen in collect(frames, every_s):
        if not seen.items and (not came or seen.status.state == "disconnected"):
            raise OSError(seen.nothing("picture").what)
        came = True
        yield from (frame.image for frame in seen.items)


def _next_free(folder: Path) -> Path:
    """``000.png`` and so on, after those that are there."""
    numbers = [int(path.stem) for path in folder.glob("*.png") if path.stem.isdigit()]
    return folder / f"{max(numbers, default=-1) + 1:03}.png"
