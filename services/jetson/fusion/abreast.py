"""Two things abreast, one on either side of the way, are one echo between them to the radar: what the lidar says of it.

A pair of receivers gives one direction per range and speed. The pillars of a gate are equally far and come nearer
equally fast, so their echoes add up and the direction comes out as straight ahead. Only the speed tells: what stands
beside the way comes nearer more slowly, by a few per cent, and the radar says with each track how far beside that lets
it be (``RadarTrack.beside_m``). The lidar sees both pillars and the room between them.

An alarm of a standing radar track is set aside when, at once,

- the vehicle drives, and the lidar is online and sees the whole way free, up to the track and beyond;
- it sees something on either side of the way, as far from the radar as the track, or a row there, as of parked cars,
  that goes on from nearer to farther: its rays meet a row at a flat angle and miss the corners that reflect;
- and each of these may be the echo by its speed.

Where the speed says that the track is beside the way by half its distance and more, nothing has to be seen there: what
comes nearer so much more slowly is not ahead. It may be hidden from the lidar, as the wall behind parked cars is.

A CAUTION about a standing track beyond what the lidar sees waits until it is near enough for both, if the lidar sees
nothing in the way there, and the way free for ``EARLY_S`` longer than a stop needs. Where the lidar sees it as well,
nearer than where its own CAUTION begins, and says SAFE nevertheless, as before the outer wall of a bend, it waits too.
IMMINENT, which is what a stop needs, never waits.

What the lidar does not see (a pane, a low box) alarms as soon as its speed shows that it is none of what stands beside;
exactly between two stronger things, their echo hides it. Pure.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from common.message_types import Level, worst
from common.messages import Cover, LidarZones, Motion, RadarTrack, RadarTracks
from common.path import Path, PathConfig, carried, is_driving
from services.jetson.fusion.coverage import ACROSS, CELL_M, sees, strip
from services.jetson.fusion.evidence import Abreast
from services.jetson.fusion.readings import track_sighting

NEARER_M, FARTHER_M = 0.4, 0.7  # a track's range is that of a body's nearest part: what reflects is up to 0.6 m behind
BESIDE_M = 0.1  # how well a place beside the way is known
ALONG_M, ACROSS_M, MISSED = 2.0, 0.3, 1  # rays of a row end no farther apart, with one sector between them at the most
SHOWN_S = 0.5
FAR_BESIDE = 0.5  # of its distance; it comes nearer 13 per cent more slowly than what is ahead
EARLY_S = 0.75  # before it has to brake the vehicle sees it with both


class Dated(NamedTuple):
    """Messages of radar and lidar with the ages of their measurements."""

    radar: RadarTracks
    radar_age_s: float
    lidar: LidarZones
    lidar_age_s: float


class AbreastWatch:
    """``set_aside`` with every verdict. Remembers for ``SHOWN_S`` which tracks are beside: a scan may miss one."""

    def __init__(self, config: PathConfig) -> None:
        self._config = config
        self._shown_ns: dict[int, int] = {}  # by track: stamp of the radar message in which that was shown last

    def set_aside(self, seen: Dated, motion: Motion | None) -> Abreast | None:
        """What is left of the radar's alarms, None = nothing is set aside.

        Args:
            motion: of the vehicle, None = unknown.
        """
        cover, radar = seen.lidar.cover, seen.radar.cover
        alarms = [track for track in seen.radar.tracks if track.level != "SAFE"]
        if motion is None or not is_driving(motion, self._config) or cover is None or radar is None or not alarms:
            return None
        path = Path(self._config, motion)
        points, sectors = _returns(cover, path, seen.lidar_age_s - seen.radar_age_s)
        in_way = path.contains(*path.locate(points))
        flanks = _with_rows(_flanks(points[~in_way], radar, path), sectors[~in_way])
        free_m = _free_m(cover, path) + self._config.front_m - radar.x_m
        may_be = [track for track in alarms if track.beside_m is not None and track.range_m + FARTHER_M <= free_m]
        now_ns = seen.radar.stamp_ns
        self._shown_ns = {key: at_ns for key, at_ns in self._shown_ns.items() if 0 <= now_ns - at_ns <= SHOWN_S * 1e9}
        beside = [track for track in may_be if _is_far_beside(track, path) or _is_between(track, flanks)]
        self._shown_ns |= {track.track_id: now_ns for track in beside}
        aside = [track for track in may_be if track.track_id in self._shown_ns]
        nearest_m = float(np.hypot(*(points[in_way] - [radar.x_m, radar.y_m]).T).min(initial=np.inf))
        cautions = [track for track in alarms if track.level == "CAUTION" and track.beside_m is not None]
        if free_m >= path.stopping_m + EARLY_S * motion.speed_mps:
            aside += [track for track in cautions if _is_beyond(track, free_m, nearest_m)]
        layout = seen.lidar.layout
        if seen.lidar.level == "SAFE" and layout is not None and nearest_m <= layout.caution_m:
            aside += [track for track in cautions if _is_as_far(track, nearest_m)]
        if not aside:
            return None
        rest = [track for track in alarms if track not in aside]
        first = min(aside, key=lambda track: (track.level != "IMMINENT", track.range_m))
        level: Level = worst(*(track.level for track in rest)) if rest else "SAFE"
        return Abreast(level, tuple(map(track_sighting, rest)), first.level, round(first.range_m, 2))


def _returns(cover: Cover, path: Path, age_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) where the lidar's rays end, carried on to the time of the radar's measurement, and (N,) their sectors."""
    far_m = np.array(cover.far_m)
    bearing = cover.first_rad + (np.arange(len(far_m)) + 0.5) * cover.step_rad
    returned = (far_m > 0.0) & (far_m < far_m.max(initial=0.0))  # the farthest are those without a return
    points = np.column_stack([cover.x_m + far_m * np.cos(bearing), cover.y_m + far_m * np.sin(bearing)])[returned]
    return carried(points, path.motion, np.full(len(points), age_s)), np.flatnonzero(returned)


def _flanks(points: np.ndarray, radar: Cover, path: Path) -> np.ndarray:
    """(N, 2) of what stands beside the way: distance from the radar, and how far off its line of travel, left."""
    motion, offset = path.motion, points - [radar.x_m, radar.y_m]
    course_rad = math.atan2(motion.yaw_rate_radps * radar.x_m, motion.speed_mps - motion.yaw_rate_radps * radar.y_m)
    aside = math.cos(course_rad) * offset[:, 1] - math.sin(course_rad) * offset[:, 0]
    return np.column_stack([np.hypot(offset[:, 0], offset[:, 1]), aside])


def _with_rows(flanks: np.ndarray, sectors: np.ndarray) -> np.ndarray:
    """Flanks (N, 2) in the order of their sectors (N,), and the middles between neighbours that belong to one row."""
    apart = np.abs(np.diff(flanks, axis=0))
    in_row = (apart[:, 0] <= ALONG_M) & (apart[:, 1] <= ACROSS_M) & (np.diff(sectors) <= MISSED + 1)
    in_row &= np.sign(flanks[1:, 1]) == np.sign(flanks[:-1, 1])
    return np.concatenate([flanks, 0.5 * (flanks[:-1] + flanks[1:])[in_row]])


def _free_m(cover: Cover, path: Path) -> float:
    """How far from the bumper the lidar sees the whole strip free."""
    rows = np.all(sees(cover, strip(path)).reshape(-1, ACROSS), axis=1).ravel()
    return CELL_M * (int(np.argmin(rows)) if not rows.all() else len(rows))


def _is_beyond(track: RadarTrack, free_m: float, nearest_m: float) -> bool:
    """It stands where the lidar sees no more, and its speed may be that of a flank.

    Not where the lidar sees no more because something is in the way: ``nearest_m`` from the radar, inf = nothing.
    """
    return track.range_m + FARTHER_M > free_m and nearest_m > track.range_m + FARTHER_M


def _is_as_far(track: RadarTrack, range_m: float | np.ndarray) -> np.ndarray:
    """Whether what the lidar sees at these distances from the radar may be what the radar sees."""
    return np.asarray((range_m >= track.range_m - NEARER_M) & (range_m <= track.range_m + FARTHER_M))


def _is_far_beside(track: RadarTrack, path: Path) -> bool:
    """Its speed alone says so; in a curve the way itself leads off the line of travel."""
    leads_off_m = 0.5 * abs(path.curvature_per_m) * track.range_m**2
    return track.beside_m is not None and track.beside_m[0] - leads_off_m >= FAR_BESIDE * track.range_m


def _is_between(track: RadarTrack, flanks: np.ndarray) -> bool:
    """Something on either side is as far from the radar, and may have the track's speed."""
    if track.beside_m is None:
        return False
    least_m, most_m = track.beside_m
    range_m, aside_m = flanks.T
    as_far = _is_as_far(track, range_m)
    as_fast = (np.abs(aside_m) >= least_m - BESIDE_M) & (np.abs(aside_m) <= most_m + BESIDE_M)
    sides = np.sign(aside_m[as_far & as_fast])
    return bool((sides > 0).any() and (sides < 0).any())
