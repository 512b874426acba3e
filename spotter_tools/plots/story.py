"""What happened, from a recording: collected first, without a picture; then drawn on one page."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib.collections import LineCollection

from common import messages as m
from common.topics import SENSOR_TOPICS, spoken
from spotter_tools.plots.paper import LEVEL_COLOURS, STATE_COLOURS, new_figure, save
from spotter_tools.plots.roadside import object_tracks

GAP_S = 0.5  # a verdict or a state does not last through a longer silence
MAX_CAUSES = 12
CAUSE_LENGTH = 110


@dataclass
class Span:
    """Something that held from one time to another."""

    start_s: float
    end_s: float
    what: str
    why: str = ""


@dataclass
class Story:
    """Times are seconds since the first message of the recording."""

    verdicts: list[Span] = field(default_factory=list)
    sensors: dict[str, list[Span]] = field(default_factory=dict)
    ranges_m: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    ttc_s: list[tuple[float, float]] = field(default_factory=list)
    roadside: m.ObjectTracks | None = None
    trails_m: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    length_s: float = 0.0

    def add(self, at_s: float, message: m.Message) -> None:
        """Add one message, in the order of time."""
        self.length_s = max(self.length_s, at_s)
        if isinstance(message, m.Verdict):
            _extend(self.verdicts, at_s, message.level, message.because, GAP_S)
        elif isinstance(message, m.SystemHealth):
            for name, sensor in message.sensors.items():
                _extend(self.sensors.setdefault(name, []), at_s, sensor.state, sensor.reason, 4 * GAP_S)
        elif isinstance(message, m.ObjectTracks):
            self._roadside(message)
        else:
            self._ranges(at_s, message)

    def _ranges(self, at_s: float, message: m.Message) -> None:
        """The nearest that each sensor of the vehicle sees."""
        found: list[float] = []
        if isinstance(message, m.RadarTracks):
            found = [track.range_m for track in message.tracks if track.moving or track.approaching]
            times_s = [track.ttc_s for track in message.tracks if track.ttc_s is not None]
            self.ttc_s.append((at_s, min(times_s, default=math.nan)))
        elif isinstance(message, m.LidarZones):
            zones = (message.left, message.centre, message.right)
            found = [zone.nearest_m for zone in zones if zone.nearest_m is not None]
        elif isinstance(message, m.CameraDetections):
            found = [one.distance_m for one in message.detections if one.in_zone]
        else:
            return
        name = next(name for name, topic in SENSOR_TOPICS.items() if topic.message is type(message))
        self.ranges_m.setdefault(name, []).append((at_s, min(found, default=math.nan)))

    def _roadside(self, message: m.ObjectTracks) -> None:
        self.roadside = message
        for track in message.tracks:
            self.trails_m.setdefault(track.track_id, []).append((track.position_m[0], track.position_m[1]))

    def changes(self) -> Iterator[Span]:
        """The verdicts at which the level changed."""
        for index, span in enumerate(self.verdicts):
            if index == 0 or span.what != self.verdicts[index - 1].what:
                yield span


def _extend(spans: list[Span], at_s: float, what: str, why: str, gap_s: float) -> None:
    """Continue the last span or begin the next; after a silence the last one ended where the silence began."""
    if spans and at_s - spans[-1].end_s <= gap_s:
        spans[-1].end_s = at_s
        if spans[-1].what == what:
            return
    spans.append(Span(at_s, at_s, what, why))


def plot_story(story: Story, title: str, path: Path) -> None:
    """Write a PNG: verdicts with causes, sensor states, ranges and TTC, and the roadside at the end.

    Raises:
        ValueError: the recording holds nothing that can be drawn.
    """
    if not (story.verdicts or story.sensors or story.ranges_m or story.roadside):
        raise ValueError("holds no verdict, health, range or track to draw")
    figure = new_figure(13.0, 10.0)
    grid = figure.add_gridspec(4, 2, height_ratios=[0.6, 1.0, 1.6, 1.0], width_ratios=[1.5, 1.0])
    verdicts = figure.add_subplot(grid[0, 0])
    states, ranges, ttc = (figure.add_subplot(grid[row, 0], sharex=verdicts) for row in (1, 2, 3))
    _draw_verdicts(verdicts, story)
    _draw_states(states, story)
    _draw_ranges(ranges, story)
    _draw_ttc(ttc, story)
    _draw_roadside(figure.add_subplot(grid[2:, 1]), story)
    _draw_causes(figure.add_subplot(grid[:2, 1]), story)
    ttc.set_xlabel("s since the start of the recording")
    ttc.set_xlim(0, max(story.length_s, 1e-3))
    figure.suptitle(title)
    save(figure, path)


def _draw_spans(axes: Any, row: float, spans: list[Span], colours: dict[str, str]) -> None:
    for span in spans:
        axes.barh(row, span.end_s - span.start_s, left=span.start_s, height=0.8, color=colours[span.what])


def _draw_verdicts(axes: Any, story: Story) -> None:
    for row, level in enumerate(LEVEL_COLOURS):
        _draw_spans(axes, row, [span for span in story.verdicts if span.what == level], LEVEL_COLOURS)
    axes.set(
        yticks=range(3), yticklabels=list(LEVEL_COLOURS), ylim=(-0.5, 2.5), title="Verdict", xlim=(0, story.length_s)
    )
    for number, span in enumerate(list(story.changes())[:MAX_CAUSES], start=1):
        axes.text(span.start_s, 2.52, str(number), fontsize=7, va="bottom", ha="center")


def _draw_causes(axes: Any, story: Story) -> None:
    axes.set_axis_off()
    changes = list(story.changes())
    lines = [
        f"{number:>2}  {span.start_s:6.2f} s  {span.what}\n      {_short(span.why)}"
        for number, span in enumerate(changes[:MAX_CAUSES], start=1)
    ]
    if len(changes) > MAX_CAUSES:
        lines.append(f"    and {len(changes) - MAX_CAUSES} more")
    axes.text(0, 1, "\n".join(lines) or "no verdict in this recording", va="top", fontsize=7.5, family="monospace")
    axes.set_title("Why", loc="left")


def _short(text: str) -> str:
    return textwrap.fill(textwrap.shorten(text, CAUSE_LENGTH, placeholder=" ..."), 60, subsequent_indent=" " * 6)


def _draw_states(axes: Any, story: Story) -> None:
    names = list(story.sensors)[::-1]
    for row, name in enumerate(names):
        _draw_spans(axes, row, story.sensors[name], STATE_COLOURS)
    axes.set(
        yticks=range(len(names)),
        yticklabels=[*map(spoken, names)],
        title="Sensors: green online, amber degraded, red disconnected",
    )


def _draw_ranges(axes: Any, story: Story) -> None:
    for name, points in sorted(story.ranges_m.items()):
        axes.plot(*zip(*points, strict=True), ".-", ms=3, lw=0.8, label=spoken(name))
    if story.ranges_m:
        axes.legend(loc="upper right")
    axes.set(ylabel="m", ylim=(0, None), title="Nearest that each sensor sees (radar: of what moves)")
    axes.grid(alpha=0.3)


def _draw_ttc(axes: Any, story: Story) -> None:
    if story.ttc_s:
        axes.plot(*zip(*story.ttc_s, strict=True), ".", ms=4, color="#c8102e")
    axes.set(ylabel="s", ylim=(0, 6), title="Radar: time to collision")
    axes.grid(alpha=0.3)


def _draw_roadside(axes: Any, story: Story) -> None:
    if story.roadside is None:
        axes.set_axis_off()
        return
    here = {track.track_id for track in story.roadside.tracks}
    ways = {track_id: way for track_id, way in story.trails_m.items() if max(math.dist(way[0], at) for at in way) > 1.0}
    colours = ["#0b63b5" if track_id in here else "#ccd4db" for track_id in ways]
    # Not in the limits of the view: who drove through long ago shall not shrink those who are here.
    lines_m = [[(y_m, x_m) for x_m, y_m in way] for way in ways.values()]
    axes.add_collection(LineCollection(lines_m, colors=colours, linewidths=0.8), autolim=False)
    object_tracks(axes, story.roadside)
    axes.set_title(f"Roadside at the end: {len(here)} tracks and their ways")
