"""A picture of one message, whichever it is."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import image as mpl_image
from matplotlib.patches import Rectangle

from common import messages as m
from spotter_tools.plots.fields import fields
from spotter_tools.plots.paper import LEVEL_COLOURS, STATE_COLOURS, new_figure, save, top_view
from spotter_tools.plots.roadside import clusters, object_tracks, points


def plot_message(key: str, message: m.Message, path: Path) -> None:
    """Write a PNG; of a kind without a picture of its own, its fields as text."""
    figure = new_figure()
    axes = figure.subplots()
    _DRAWINGS.get(type(message), fields)(axes, message)
    state = f", {message.state}" if isinstance(message, m.SensorMessage) else ""
    reason = f": {message.reason}" if isinstance(message, m.SensorMessage) and message.reason else ""
    figure.suptitle(f"{key}{state}{reason}", wrap=True)
    save(figure, path)


def _radar_tracks(axes: Any, message: m.RadarTracks) -> None:
    top_view(axes, message.range_max_m or None)
    for track in message.tracks:
        azimuth_rad = track.azimuth_rad or 0.0
        x_m, y_m = track.range_m * math.cos(azimuth_rad), track.range_m * math.sin(azimuth_rad)
        colour = LEVEL_COLOURS[track.level]
        axes.plot(y_m, x_m, "o", color=colour, ms=10, mfc="none" if track.coasting else colour)
        ahead_m, left_m = (0.5 * track.velocity_mps * part for part in (math.cos(azimuth_rad), math.sin(azimuth_rad)))
        axes.annotate("", (y_m + left_m, x_m + ahead_m), (y_m, x_m), arrowprops={"arrowstyle": "->", "color": colour})
        ttc = "" if track.ttc_s is None else f", TTC {track.ttc_s:.1f} s"
        axes.annotate(
            f"#{track.track_id} {track.velocity_mps:+.1f} m/s{ttc}", (y_m, x_m), (8, 6), textcoords="offset points"
        )
    axes.set_title(f"{message.level}, {len(message.tracks)} tracks{'' if message.settled else ', not settled'}")


def _radar_detections(axes: Any, message: m.RadarDetections) -> None:
    shown = axes.pcolormesh(
        message.velocity_axis_mps, message.range_axis_m, message.range_doppler_db, cmap="magma", shading="nearest"
    )
    axes.figure.colorbar(shown, ax=axes, label="dB")
    for found in message.detections:
        axes.plot(found.velocity_mps, found.range_m, "o", mfc="none", mec="#00e5ff", ms=12)
    axes.set(
        xlabel="velocity, m/s (closing is negative)", ylabel="range, m", title=f"{len(message.detections)} detections"
    )


def _laser_scan(axes: Any, message: m.LaserScan) -> None:
    top_view(axes)
    seen = message.ranges_m > 0
    angles_rad, ranges_m = message.angles_rad[seen], message.ranges_m[seen]
    points = axes.scatter(
        ranges_m * np.sin(angles_rad), ranges_m * np.cos(angles_rad), s=4, c=message.confidence[seen], cmap="viridis"
    )
    axes.invert_xaxis()
    axes.figure.colorbar(points, ax=axes, label="confidence")
    axes.plot(0, 0, "^", color="black", ms=10)
    axes.set_title(f"{np.count_nonzero(seen)} of {len(seen)} beams returned")


def _lidar_zones(axes: Any, message: m.LidarZones) -> None:
    layout = message.layout or m.LaneLayout(
        centre_width_m=1.0, side_width_m=1.0, look_ahead_m=3.0, imminent_m=0.0, caution_m=0.0
    )
    half_m = layout.centre_width_m / 2
    edges_m = {"left": half_m, "centre": -half_m, "right": -half_m - layout.side_width_m}
    for name, right_m in edges_m.items():
        zone: m.LidarZone = getattr(message, name)
        width_m = layout.centre_width_m if name == "centre" else layout.side_width_m
        colour = LEVEL_COLOURS[zone.level]
        axes.add_patch(Rectangle((right_m, 0), width_m, layout.look_ahead_m, fc=colour, alpha=0.25, ec="black"))
        nearest = "free" if zone.nearest_m is None else f"{zone.nearest_m:.2f} m"
        axes.text(
            right_m + width_m / 2, layout.look_ahead_m * 0.92, f"{name}\n{zone.level}\n{nearest}", ha="center", va="top"
        )
        if zone.nearest_m is not None:
            axes.plot([right_m, right_m + width_m], [zone.nearest_m] * 2, color=colour, lw=4)
    for line_m, level in ((layout.imminent_m, "IMMINENT"), (layout.caution_m, "CAUTION")):
        if line_m:
            axes.axhline(line_m, ls="--", color=LEVEL_COLOURS[level])
    top_view(axes)
    outer_m = half_m + layout.side_width_m + 0.3
    axes.set(
        aspect="auto",  # lanes are narrow: their words need the room
        xlim=(outer_m, -outer_m),
        ylim=(0, layout.look_ahead_m + 0.1),
        title=f"{message.level} (raw {message.raw_level})",
    )


def _camera(axes: Any, message: m.CameraDetections) -> None:
    width_px, height_px = message.image_size_px
    axes.add_patch(Rectangle((0, 0), width_px, height_px, fc="#20262c"))
    for found in message.detections:
        left, top, right, bottom = found.box_xyxy_px
        colour = LEVEL_COLOURS[found.level] if found.in_zone else "#a9b6c3"
        axes.add_patch(Rectangle((left, top), right - left, bottom - top, fill=False, ec=colour, lw=2))
        most = "at most " if found.truncated else ""
        words = f"{found.label} {found.confidence:.0%} {most}{found.distance_m:.1f} m"
        axes.text(left + 2, max(top - 4, 0.05 * height_px), words, color=colour, clip_on=True)
    axes.set(xlim=(0, width_px), ylim=(height_px, 0), aspect="equal", xlabel="px", ylabel="px")
    axes.set_title(f"{message.level or 'nothing in the zone'}, brightness {message.brightness:.0f} of 255")


def _image(axes: Any, message: m.CompressedImage) -> None:
    axes.imshow(mpl_image.imread(io.BytesIO(message.data), format=message.format))
    axes.set_axis_off()


def _verdict(axes: Any, message: m.Verdict) -> None:
    axes.set_facecolor(LEVEL_COLOURS[message.level])
    axes.set(xticks=[], yticks=[], xlim=(0, 1), ylim=(0, 1))
    ink = "black" if message.level == "CAUTION" else "white"
    axes.text(0.04, 0.82, f"{message.level}  {message.permission}", fontsize=34, weight="bold", color=ink)
    axes.text(0.04, 0.70, f"{message.because} (rule {message.rule})", fontsize=11, color=ink, wrap=True)
    lines = [
        f"{name}: {used.state}, {used.level or 'nothing'}, "
        f"{'never seen' if used.age_ms is None else f'{used.age_ms:.0f} ms old'}; {used.why}"
        for name, used in message.inputs.items()
    ]
    axes.text(0.04, 0.62, "\n".join(lines), fontsize=9, color=ink, va="top", wrap=True)
    if message.to_lower:
        axes.text(0.04, 0.06, f"To come down: {message.to_lower}", fontsize=9, color=ink, wrap=True)


def _health(axes: Any, message: m.SystemHealth) -> None:
    names = list(message.sensors)[::-1]
    for row, name in enumerate(names):
        sensor = message.sensors[name]
        axes.barh(row, 1, color=STATE_COLOURS[sensor.state])
        age = "never seen" if sensor.age_ms is None else f"{sensor.age_ms:.0f} ms, {sensor.rate_hz:.1f} Hz"
        axes.text(0.01, row, f"{sensor.state}  {age}  {sensor.reason}", va="center", color="white")
    axes.set(yticks=range(len(names)), yticklabels=names, xticks=[], xlim=(0, 1), title=message.summary)


def _status(axes: Any, message: m.ServiceStatus) -> None:
    stages = list(message.stage_ms)[::-1]
    axes.barh(stages, [message.stage_ms[name] for name in stages], color="#0b63b5")
    summary = f"{message.state} {message.reason}; {message.rate_hz:.1f} Hz, {message.rss_mb:.0f} MB"
    axes.set(
        xlabel="ms",
        title=f"{summary}, {message.published} published, {message.dropped} dropped, {message.bad_input} bad",
    )


_DRAWINGS: dict[type[m.Message], Callable[[Any, Any], None]] = {
    m.RadarTracks: _radar_tracks,
    m.RadarDetections: _radar_detections,
    m.LaserScan: _laser_scan,
    m.LidarZones: _lidar_zones,
    m.CameraDetections: _camera,
    m.CompressedImage: _image,
    m.ObjectTracks: object_tracks,
    m.Clusters: clusters,
    m.PointCloud: points,
    m.Verdict: _verdict,
    m.SystemHealth: _health,
    m.ServiceStatus: _status,
}
