"""What tracks mean while the vehicle drives and its motion is known: the way ahead decides.

Each track has a time to contact with the vehicle's outline on its way. What passes beside does not alarm; what stands
in the way does. Without a known motion, standing or in reverse, ``alarm.py`` decides by the article's rules.

One pair of receivers gives one direction per range and speed: two parked cars that are abreast, left and right, look
like one thing between them. Their Doppler tells the truth (``standing.py``).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from common.messages import Level, Motion, worst
from common.path import MovingPoint, Path, is_driving
from services.radar_pi.config import PathAlarmConfig, RadarConfig
from services.radar_pi.over_ground import GroundFilter, OverGround
from services.radar_pi.standing import SpeedScale, Standing
from services.radar_pi.tracking import Track

_NO_VELOCITY = np.zeros(2)


@dataclass
class Course:
    """How a track and the vehicle's way meet, over the frames of the track's life."""

    contact_s: float | None = None  # time to contact; None = it passes
    straight_s: float | None = None  # the same if the vehicle left its curve now
    ahead_m: float = 0.0  # along the way, from the bumper; negative: abreast or behind
    in_corridor: bool = False  # within the strip ahead in this frame
    on_way: bool = False  # it meets the way, in enough frames in a row
    votes: int = field(default=0, repr=False)  # frames in a row that say otherwise than ``on_way``


@dataclass
class Meeting:
    """What is known of a track while the vehicle drives."""

    ground: OverGround
    standing: Standing
    possible: Course = field(default_factory=Course)  # unless its speed shows for certain that it stands beside
    likely: Course = field(default_factory=Course)  # unless its speed shows that it rather stands beside


class Way:
    """Follows every track over ground while the motion is known. ``update`` is called once per frame."""

    def __init__(self, config: RadarConfig) -> None:
        self._config = config
        self._filter = GroundFilter(config.mounting.mount, config.tracking, config.on_path)
        self._scale = SpeedScale(config.on_path)
        self._stamp_ns: int | None = None
        self._path: Path | None = None

    @property
    def driving(self) -> bool:
        """Whether the way ahead decides in this frame."""
        return self._path is not None

    def update(self, stamp_ns: int, tracks: list[Track], motion: Motion | None) -> None:
        """Carry all tracks, the unconfirmed too, on to this frame and see where they meet the way."""
        last_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        if motion is None or not is_driving(motion, self._config.path):
            self._path = None
            for track in tracks:
                track.meeting = None
            return
        self._path = Path(self._config.path, motion)
        dt_s = 0.0 if last_ns is None else max(0.0, (stamp_ns - last_ns) * 1e-9)
        self._scale.age(dt_s)
        for track in tracks:
            self._follow(track, motion, dt_s)
            if track.meeting is not None:
                self._meet(track, track.meeting, self._path, dt_s)

    def level(self, track: Track) -> Level:
        """By the time to contact and, in the corridor, by the distance; what a stop needs counts as imminent."""
        meeting, path, alarm = track.meeting, self._path, self._config.alarm
        if meeting is None or path is None:
            return "SAFE"
        if not track.approaching and abs(track.velocity_mps) >= self._config.tracking.moving_mps:
            return "SAFE"
        half_frame_s = self._config.waveform.frame_period_s / 2  # the next frame would be late by as much on average
        imminent_s = max(alarm.imminent_ttc_s, path.stopping_m / path.motion.speed_mps) + half_frame_s
        if _within(meeting.possible, imminent_s, alarm.imminent_range_m):
            return "IMMINENT"
        likely = meeting.likely
        ahead_only = likely.straight_s is None  # on the curve, not straight ahead: the vehicle may leave the curve
        caution_s = (
            imminent_s + self._config.on_path.curve_lead_s if ahead_only else max(imminent_s, alarm.caution_ttc_s)
        )
        return "CAUTION" if _within(likely, caution_s, alarm.caution_range_m) else "SAFE"

    def static_level(self, standing: list[Track]) -> Level | None:
        """What standing tracks on the way say; None = nothing stands."""
        return worst(*(self.level(track) for track in standing)) if standing else None

    def _follow(self, track: Track, motion: Motion, dt_s: float) -> None:
        """The track's state over ground and what speaks against its standing still, after this frame."""
        meeting, measured = track.meeting, track.measured
        if meeting is None:
            if measured is None:
                return
            meeting = track.meeting = Meeting(self._filter.start(measured, motion), Standing(self._config, self._scale))
        else:
            meeting.ground = self._filter.predict(meeting.ground, motion, dt_s)
            if measured is not None:
                meeting.ground = self._filter.correct(meeting.ground, measured, motion)
        if measured is not None and track.strongest is not None:
            meeting.standing.update(track.strongest, motion)

    def _meet(self, track: Track, meeting: Meeting, path: Path, dt_s: float) -> None:
        """Both courses; they differ only by how sure the track's speed has to be."""
        settings = self._config.on_path
        for course, sigmas in ((meeting.possible, settings.certain_sigmas), (meeting.likely, settings.likely_sigmas)):
            points = list(self._places(track, meeting, path, meeting.standing.least_beside_m(sigmas)))
            contact_s = _first_contact_s(path, points, settings)
            meets = contact_s is not None
            if contact_s is None and course.on_way and course.contact_s is not None:
                contact_s = max(0.0, course.contact_s - dt_s)  # until enough frames say that it passes
            course.contact_s = course.straight_s = contact_s
            if path.curvature_per_m and contact_s is not None:
                course.straight_s = _first_contact_s(Path(path.config, path.motion.straight()), points, settings)
            ahead, beside = path.locate(np.array([point.position_m for point in points]))
            sigma_m = np.sqrt([point.covariance[1, 1] for point in points] + path.spread_m(ahead) ** 2)
            inside = path.contains(ahead, beside, np.minimum(settings.sigmas * sigma_m, settings.widest_m))
            course.in_corridor = bool(inside.any())
            course.ahead_m = float(ahead[inside].min() if course.in_corridor else ahead.min())
            # What is only carried on is no vote: neither an echo that failed to come, nor a contact of earlier frames
            if track.measured is not None:
                self._vote(course, meets or course.in_corridor)

    def _vote(self, course: Course, meets: bool) -> None:
        """Several frames in a row decide, as they do for the approach gate."""
        course.votes = course.votes + 1 if meets != course.on_way else 0
        if course.votes >= self._config.on_path.way_frames:
            course.on_way, course.votes = meets, 0

    def _sure_mps(self, ground: OverGround, path: Path) -> np.ndarray:
        """The velocity; of what is beside the way without a part towards it that may as well be none.

        The azimuth wavers: who goes along beside the way seems to drift into it now and then.
        """
        velocity = ground.state[2:]
        if path.contains(*path.locate(ground.state[None, :2]))[0]:
            return velocity
        towards = path.towards(ground.state[:2])
        nearing_mps = float(velocity @ towards)
        sigma_mps = float(towards @ ground.covariance[2:, 2:] @ towards) ** 0.5
        drifts = 0.0 < nearing_mps < self._config.on_path.sure_sigmas * sigma_mps
        return velocity - nearing_mps * towards if drifts else velocity

    def _places(self, track: Track, meeting: Meeting, path: Path, least_m: float) -> Iterable[MovingPoint]:
        """Where the track may be: as the filter has it, but what stands no nearer to the way than its speed shows."""
        ground = meeting.ground
        if meeting.standing.has_moved:
            yield MovingPoint(ground.state[:2], self._sure_mps(ground, path), ground.covariance)
            return
        covariance = np.zeros((4, 4))
        covariance[:2, :2] = ground.covariance[:2, :2]
        sigma_m = float(covariance[1, 1] ** 0.5)
        for place_m, sideways_m in meeting.standing.places(ground.state[:2], sigma_m, track.range_m, least_m):
            allowed = covariance.copy()
            allowed[1, 1] = sideways_m**2
            yield MovingPoint(place_m, _NO_VELOCITY, allowed)


def _within(course: Course, contact_s: float, ahead_m: float) -> bool:
    """It meets the way sooner than this, or is that near in the corridor."""
    soon = course.contact_s is not None and course.contact_s < contact_s
    return course.on_way and (soon or (course.in_corridor and course.ahead_m <= ahead_m))


def _first_contact_s(path: Path, points: list[MovingPoint], settings: PathAlarmConfig) -> float | None:
    times = [path.time_to_contact_s(point, settings.horizon_s, settings.sigmas, settings.widest_m) for point in points]
    return min((t for t in times if t is not None), default=None)
