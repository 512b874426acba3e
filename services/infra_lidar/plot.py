"""Top view of a recording: ground, clusters by class, boxes, ids and trails of tracks. PNG, GIF, MP4 with OpenCV."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imsave
from msgspec.structs import replace

from common.bus.status import Report
from common.config import ConfigError
from common.geometry import transform_points
from common.messages import ObjectTrack
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.source import open_source, surveyed_pose
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.result import FrameResult

COLOURS = {
    "car": "#3b7dd8", "large_vehicle": "#9b59d0", "cyclist": "#e8a317", "pedestrian": "#e0483e",
    "background": "#8a8f98", "unknown": "#2fb5a8",
}  # fmt: skip
_GROUND, _OTHER = "#4b5a45", "#5c6068"
_SIZE_PX = 1000
_TRAIL = 30


def plot_source(config: InfraLidarConfig, output: Path, frames: int, reach_m: float) -> int:
    """Run the pipeline over a source and draw its frames from above; returns the number of frames.

    They are drawn in the service's map frame: with the surveyed pose of the configuration or of the simulation.
    output: ``.png`` (the last frame), ``.mp4`` or ``.gif`` (all frames), anything else is a folder of PNGs.

    Raises:
        ConfigError: there is no such source, no frame of it can be read, or output is an MP4 and OpenCV is not
            installed.
    """
    if config.source:  # where there is none, open_source says so; before it a missing model is named
        config = replace(config, T_map_sensor=surveyed_pose(config))
    pipeline, trails = InfraLidarPipeline(config), Trails()
    source = islice(open_source(config, Report("plot")), frames)
    results = (pipeline.process(stamp_ns, frame.returns, frame.quality) for stamp_ns, frame in source)
    output.parent.mkdir(parents=True, exist_ok=True)
    if output.suffix == ".png":
        return _draw_last(results, trails, reach_m, output)
    pictures = (draw(result, trails.update(_visible_tracks(result)), reach_m) for result in results)
    return {".mp4": _write_video, ".gif": _write_gif}.get(output.suffix, _write_folder)(pictures, output)


def _draw_last(results: Iterator[FrameResult], trails: Trails, reach_m: float, path: Path) -> int:
    count = 0
    for result in results:
        lines, count = trails.update(_visible_tracks(result)), count + 1
    if count:
        imsave(path, draw(result, lines, reach_m))
    return count


def _visible_tracks(result: FrameResult) -> list[ObjectTrack]:
    return [track for track in result.tracks.tracks if track.state != "tentative"]


class Trails:
    """The last positions of every track, for the line behind it."""

    def __init__(self) -> None:
        self._positions: dict[int, deque[tuple[float, float]]] = defaultdict(lambda: deque(maxlen=_TRAIL))

    def update(self, tracks: list[ObjectTrack]) -> list[np.ndarray]:
        """Add the positions of this frame; returns (n, 2) x, y per track, oldest first (m, map frame)."""
        for ended in self._positions.keys() - {track.track_id for track in tracks}:
            del self._positions[ended]
        for track in tracks:
            self._positions[track.track_id].append(track.position_m[:2])
        return [np.array(self._positions[track.track_id]) for track in tracks]


def draw(result: FrameResult, trails: list[np.ndarray], reach_m: float) -> np.ndarray:
    """(H, W, 3) uint8 RGB picture of one frame in the map frame, x up, y to the left, the sensor in the middle.

    trails: of each track that is not tentative, (n, 2) x, y of its last positions (m, map frame).
    """
    figure = Figure(figsize=(_SIZE_PX / 100, _SIZE_PX / 100), dpi=100, facecolor="#16181c", layout="constrained")
    axes = figure.add_subplot(facecolor="#16181c")
    _draw_points(axes, result)
    tracks = _visible_tracks(result)
    axes.add_collection(
        LineCollection(to_axes(trails), colors=[COLOURS[t.label] for t in tracks], linewidths=1.0, alpha=0.7)
    )
    for track in tracks:
        _draw_track(axes, track)
    centre = result.T_map_sensor[:2, 3]
    axes.plot(centre[1], centre[0], marker="^", color="white", markersize=6)
    axes.set(xlim=(centre[1] + reach_m, centre[1] - reach_m), ylim=(centre[0] - reach_m, centre[0] + reach_m))
    axes.set_aspect("equal")
    axes.tick_params(colors="#9aa0a8", labelsize=8)
    moving = sum(np.hypot(*track.velocity_mps[:2]) > 0 for track in tracks)
    text = f"{result.points_in} points   {len(result.clusters)} clusters   {len(tracks)} tracks, {moving} moving"
    axes.set_title(text, color="#d5d8dc", fontsize=10)
    _draw_legend(axes)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def to_axes(trails: list[np.ndarray]) -> list[np.ndarray]:
    """(n, 2) x, y in the map frame to coordinates of the axes: y is horizontal, x vertical."""
    return [trail[:, ::-1] for trail in trails]


def _draw_points(axes: Axes, result: FrameResult) -> None:
    at = transform_points(result.T_map_sensor, result.points[:, :3])
    rest = ~result.ground & (result.cluster_id < 0) & result.points[:, :3].any(axis=1)
    for rows, colour, size in ((result.ground, _GROUND, 0.15), (rest, _OTHER, 0.15)):
        axes.plot(at[rows, 1], at[rows, 0], ",", color=colour, markersize=size, alpha=0.5)
    labels = np.array(result.clusters.labels, dtype=object)
    clustered = np.flatnonzero(result.cluster_id >= 0)
    of_point = labels[result.cluster_id[clustered]] if len(labels) else np.empty(0, object)
    for label, colour in COLOURS.items():
        rows = clustered[of_point == label]
        axes.plot(at[rows, 1], at[rows, 0], ".", color=colour, markersize=1.2)


def _draw_track(axes: Axes, track: ObjectTrack) -> None:
    length, width, _ = track.size_m
    c, s = np.cos(track.yaw_rad), np.sin(track.yaw_rad)
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) * [length / 2, width / 2]
    outline = corners @ np.array([[c, s], [-s, c]]) + track.position_m[:2]
    colour, style = COLOURS[track.label], ":" if track.state == "coasting" else "-"
    axes.plot(outline[:, 1], outline[:, 0], style, color=colour, linewidth=1.2)
    speed = float(np.hypot(*track.velocity_mps[:2]))
    x, y = track.position_m[:2]
    if speed > 0:
        axes.plot([y, y + track.velocity_mps[1]], [x, x + track.velocity_mps[0]], color="white", linewidth=0.8)
    text = f"{track.track_id % 10_000}" + (f"  {speed:.1f} m/s" if speed > 0 else "")
    axes.text(y - 0.8, x + 0.8, text, color=colour, fontsize=6, clip_on=True)


def _draw_legend(axes: Axes) -> None:
    for label, colour in COLOURS.items():
        axes.plot([], [], "s", color=colour, label=label.replace("_", " "))
    axes.legend(loc="upper right", fontsize=7, facecolor="#22252b", edgecolor="none", labelcolor="#d5d8dc")


def _write_folder(pictures: Iterator[np.ndarray], folder: Path) -> int:
    folder.mkdir(exist_ok=True)
    count = 0
    for picture in pictures:
        imsave(folder / f"{count:05d}.png", picture)
        count += 1
    return count


def _write_gif(pictures: Iterator[np.ndarray], path: Path) -> int:
    first = list(islice(pictures, 1))  # before the writer opens: of no picture it fails, which hides why none came
    if not first:
        return 0
    figure = Figure(figsize=(_SIZE_PX / 100, _SIZE_PX / 100), dpi=100)
    FigureCanvasAgg(figure)
    writer, count = PillowWriter(fps=10), 0
    with writer.saving(figure, str(path), dpi=100):
        for picture in chain(first, pictures):
            figure.clear()
            figure.figimage(picture)
            writer.grab_frame()
            count += 1
    return count


def _write_video(pictures: Iterator[np.ndarray], path: Path) -> int:
    try:
        import cv2
    except ImportError:
        raise ConfigError(f"{path}: a video needs OpenCV, which is not installed; end the name in .gif") from None
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (_SIZE_PX, _SIZE_PX))
    count = 0
    for picture in pictures:
        video.write(picture[..., ::-1])
        count += 1
    video.release()
    return count
