"""What the roadside lidar says, from above in the map frame: x is up and y is left, as on the dashboard."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.patches import Polygon

from common import messages as m
from spotter_tools.plots.paper import LABEL_COLOURS

KINDS = {"other": "#b0b8c0", "ground": "#d8c9a8", "cluster": "#c8102e", "background": "#8fb3d9"}


def object_tracks(axes: Any, message: m.ObjectTracks) -> None:
    """Boxes with class, speed and two seconds of velocity."""
    for track in message.tracks:
        colour = LABEL_COLOURS[track.label]
        axes.add_patch(
            Polygon(_box(track), fill=False, ec=colour, lw=1.8, ls="--" if track.state == "coasting" else "-")
        )
        (x_m, y_m, _), (vx, vy, _) = track.position_m, track.velocity_mps
        speed_mps = math.hypot(vx, vy)
        if speed_mps > 0.3:
            arrow = {"arrowstyle": "->", "color": colour, "lw": 1.5}
            axes.annotate("", (y_m + 2 * vy, x_m + 2 * vx), (y_m, x_m), arrowprops=arrow)
        words = f"{track.track_id % 10_000} {track.label.replace('_', ' ')}"
        words += f" {speed_mps:.1f} m/s" if speed_mps > 0.3 else ""
        axes.annotate(words, (y_m, x_m), (5, 5), textcoords="offset points", fontsize=7, color=colour, clip_on=True)
    places_m = [
        (0.0, 0.0),
        *(track.position_m[1::-1] for track in message.tracks),
    ]  # the map's origin is always in view
    axes.plot(*zip(*places_m, strict=True), alpha=0)
    axes.margins(0.1)
    _map_view(axes, f"{len(message.tracks)} tracks")


def clusters(axes: Any, message: m.Clusters) -> None:
    """A dot per cluster, as large as it is long, with its class."""
    for cluster in message.clusters:
        colour, (x_m, y_m, _) = LABEL_COLOURS[cluster.label], cluster.centre_m
        axes.plot(y_m, x_m, "o", ms=2 + cluster.size_m[0] * 2, color=colour, alpha=0.5)
        if cluster.label != "background":
            axes.annotate(cluster.label.replace("_", " "), (y_m, x_m), fontsize=7, color=colour, clip_on=True)
    _map_view(axes, f"{len(message.clusters)} clusters")


def points(axes: Any, message: m.PointCloud) -> None:
    """The cloud from above, coloured by what each point was taken for."""
    for kind, (name, colour) in enumerate(KINDS.items()):
        of_kind = message.points[message.kind == kind]
        if len(of_kind):
            axes.scatter(of_kind[:, 1], of_kind[:, 0], s=0.5, color=colour, label=name)
    axes.legend(markerscale=12)
    _map_view(axes, f"{len(message.points)} points")


def _map_view(axes: Any, title: str) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_xaxis()
    axes.grid(alpha=0.3)
    axes.set(xlabel="y (map), m", ylabel="x (map), m", title=title)


def _box(track: m.ObjectTrack) -> list[tuple[float, float]]:
    """Corners as (y, x)."""
    (x_m, y_m, _), (length_m, width_m, _) = track.position_m, track.size_m
    c, s = math.cos(track.yaw_rad), math.sin(track.yaw_rad)
    corners = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    halves = [(i * length_m / 2, j * width_m / 2) for i, j in corners]
    return [(y_m + s * dx + c * dy, x_m + c * dx - s * dy) for dx, dy in halves]
