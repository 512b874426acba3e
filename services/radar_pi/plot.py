"""A picture of one frame for a person: range-Doppler map with detections and tracks, and the tracks from above."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from common.config import ConfigError
from common.messages import RadarDetections, RadarTracks

COLOURS = {"SAFE": "#35c75a", "CAUTION": "#ffb300", "IMMINENT": "#ff3030"}
CLOSE_M = (0.5, 1.2)


def draw(path: Path, detections: RadarDetections, history: list[RadarTracks]) -> None:
    """Write a PNG; ``history`` ends with the frame of ``detections``.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigError("--plot needs matplotlib: install the extra 'plot'") from None
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    map_axes, top_axes = figure.subplots(1, 2, width_ratios=[3, 2])
    _draw_map(figure, map_axes, detections, history[-1])
    _draw_top(top_axes, history)
    newest = history[-1]
    reason = f" ({newest.reason})" if newest.reason else ""
    figure.suptitle(f"{newest.level}, {newest.state}{reason}, noise floor {newest.noise_floor_db:.1f} dB")
    figure.savefig(path, dpi=110)


def _draw_map(figure: Any, axes: Any, detections: RadarDetections, newest: RadarTracks) -> None:
    ranges_m, speeds_mps = detections.range_axis_m, detections.velocity_axis_mps
    floor_db = newest.noise_floor_db
    image = axes.pcolormesh(
        speeds_mps,
        ranges_m,
        detections.range_doppler_db - floor_db,
        vmin=0.0,
        vmax=45.0,
        cmap="magma",
        shading="nearest",
    )
    figure.colorbar(image, ax=axes, label="dB over the noise floor")
    for d in detections.detections:
        axes.plot(d.velocity_mps, d.range_m, "o", mfc="none", mec="#00e5ff", ms=12)
    for track in newest.tracks:
        axes.plot(track.velocity_mps, track.range_m, "x", color=COLOURS[track.level], ms=10, mew=2)
        ttc = "" if track.ttc_s is None else f" TTC {track.ttc_s:.1f} s"
        axes.annotate(
            f"{track.track_id}{ttc}", (track.velocity_mps, track.range_m),
            xytext=(8, 6), textcoords="offset points", color="white",
        )  # fmt: skip
    axes.set(xlabel="velocity, m/s (closing is negative)", ylabel="range, m", title="Range-Doppler, after MTI")
    axes.set_ylim(0.0, float(ranges_m[-1]))


def _draw_top(axes: Any, history: list[RadarTracks]) -> None:
    """Tracks from above, x forward is up, y left is left; the past as a line."""
    angle = np.linspace(-np.pi / 3, np.pi / 3, 60)
    for radius_m in CLOSE_M:
        axes.plot(radius_m * np.sin(angle), radius_m * np.cos(angle), "--", color="grey", lw=0.8)
    paths: dict[int, list[tuple[float, float]]] = {}
    for message in history:
        for track in message.tracks:
            azimuth = track.azimuth_rad or 0.0
            point = (-track.range_m * np.sin(azimuth), track.range_m * np.cos(azimuth))
            paths.setdefault(track.track_id, []).append(point)
    newest = {track.track_id: track for track in history[-1].tracks}
    for track_id, points in paths.items():
        across, ahead = np.array(points).T
        now = newest.get(track_id)
        axes.plot(across, ahead, "-", lw=1.2, color=COLOURS[now.level] if now else "lightgrey")
        if now:
            axes.plot(across[-1], ahead[-1], "o", color=COLOURS[now.level])
            axes.annotate(str(track_id), (across[-1], ahead[-1]), xytext=(6, 4), textcoords="offset points")
    reach_m = history[-1].range_max_m
    axes.set(xlim=(-reach_m / 2, reach_m / 2), ylim=(0.0, reach_m), aspect="equal")
    axes.set(xlabel="left  -  right, m", ylabel="ahead, m", title="Tracks from above")
