"""What all pictures share: colours, a figure without a screen, lengths in metres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

LEVEL_COLOURS = {"SAFE": "#1f7a45", "CAUTION": "#e09a00", "IMMINENT": "#c8102e"}
STATE_COLOURS = {"online": "#1f7a45", "starting": "#8a97a3", "degraded": "#e09a00", "disconnected": "#c8102e"}
LABEL_COLOURS = {
    "car": "#0b63b5",
    "large_vehicle": "#6a3fc0",
    "cyclist": "#985600",
    "pedestrian": "#12703c",
    "background": "#5c6873",
    "unknown": "#b3202c",
}
DPI = 110


def new_figure(width_in: float = 9.0, height_in: float = 6.0) -> Figure:
    """A figure that is never shown, so that it works without a display and leaves no state behind."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


KINDS = {".png": "Software", ".svg": "Creator", ".pdf": "Creator"}  # and the field that names the program
"""Endings of files that can be written."""


def save(figure: Figure, path: Path) -> None:
    """Write the figure in the format of the path's ending.

    Raises:
        ValueError: an ending that is none of ``KINDS``.
        OSError: the folder cannot be written to.
    """
    if path.suffix.lower() not in KINDS:
        raise ValueError(f"{path}: expected a name that ends in {', '.join(KINDS)}")
    figure.savefig(path, dpi=DPI, metadata={KINDS[path.suffix.lower()]: "spotter"})


def top_view(axes: Any, reach_m: float | None = None) -> None:
    """Axes for a view from above in a sensor's frame: ahead is up, left is left."""
    axes.set(xlabel="left  -  right, m", ylabel="ahead, m", aspect="equal")
    axes.grid(alpha=0.3)
    if reach_m:
        axes.set(xlim=(reach_m / 2, -reach_m / 2), ylim=(0.0, reach_m))
