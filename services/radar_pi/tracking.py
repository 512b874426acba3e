"""Kalman tracks in range, range rate and azimuth; the filter's steps are filterpy's.

Constant velocity with white acceleration; azimuth is a random walk. Gates are Mahalanobis distances from the
*predicted* measurement, so a target may move any distance between two frames. Assignment: Munkres / Jonker-Volgenant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from filterpy.kalman import predict, update
from scipy.linalg.lapack import dposv
from scipy.optimize import linear_sum_assignment

from services.radar_pi.config import DetectionConfig, TrackingConfig
from services.radar_pi.detection import Detection, Echo

if TYPE_CHECKING:
    from services.radar_pi.way import Meeting

RANGE, VELOCITY, AZIMUTH = range(3)
_UNKNOWN_AZIMUTH_VARIANCE = 1.0
_OBSERVE = np.eye(3)  # range, velocity and azimuth are measured as they are
_FAR = 1e6


@dataclass
class Track:
    """One body over time. Counters are in frames."""

    state: np.ndarray  # (3,) metres, metres per second, radians
    covariance: np.ndarray  # (3, 3)
    snr_db: float
    has_azimuth: bool
    track_id: int = 0  # given on confirmation
    age: int = 1  # detections since creation
    misses: int = 0  # in a row
    closing: int = 0  # closing detections in a row; a miss starts over
    not_closing: int = 0  # detections in a row that do not close
    approaching: bool = False  # the approach gate has passed
    last_approach_ns: int | None = None
    folds: int = 0  # how often the speed went round when the track began; 0 = the speed as it was measured
    origin: int = 0  # tracks of one origin are readings of the same detection; one of them is true
    misfit: float = 0.0  # sum of the squared Mahalanobis distances of its detections
    began: tuple[int, float] = (0, 0.0)  # stamp and range of its first detection
    seen_m: float = 0.0  # range of its last detection
    measured: np.ndarray | None = None  # in this frame: range, velocity and, where known, azimuth; None = missed
    strongest: Echo | None = None  # in this frame
    meeting: Meeting | None = None  # with the vehicle's way, while it drives

    @property
    def confirmed(self) -> bool:
        """Whether it has been published: such a track has an id."""
        return self.track_id > 0

    @property
    def range_m(self) -> float:
        """Estimated range, not negative."""
        return max(0.0, float(self.state[RANGE]))

    @property
    def velocity_mps(self) -> float:
        """Estimated radial velocity, negative when it approaches."""
        return float(self.state[VELOCITY])

    @property
    def azimuth_rad(self) -> float | None:
        """Estimated azimuth; None before it was measured."""
        return float(self.state[AZIMUTH]) if self.has_azimuth else None


class Tracker:
    """All tracks of one radar. ``update`` is called once per frame, with no detections too."""

    def __init__(
        self, config: TrackingConfig, body: DetectionConfig, v_max_mps: float, range_lead_s: float = 0.0
    ) -> None:
        self._config = config
        self._body = body
        self._v_max_mps = v_max_mps
        self._range_lead_s = range_lead_s  # a detection's range was corrected for its velocity times this
        self._noise = np.diag([config.sigma_range_m**2, config.sigma_velocity_mps**2, config.sigma_azimuth_rad**2])
        self._next_id = 1
        self._next_origin = 0
        self._stamp_ns: int | None = None
        self.tracks: list[Track] = []

    @property
    def confirmed(self) -> list[Track]:
        """The confirmed tracks."""
        return [track for track in self.tracks if track.confirmed]

    def update(self, stamp_ns: int, detections: list[Detection]) -> list[Track]:
        """Predict, associate, correct, create, delete. Returns the confirmed tracks."""
        dt_s = 0.0 if self._stamp_ns is None else max(0.0, (stamp_ns - self._stamp_ns) * 1e-9)
        self._stamp_ns = stamp_ns
        self._predict(dt_s)
        free = list(range(len(detections)))
        for group in (self.confirmed, [track for track in self.tracks if not track.confirmed]):
            taken = self._associate(group, detections, free)
            for i, track in enumerate(group):
                j = taken.get(i, self._taken_by_another_reading(track, group, taken, detections))
                if j is None:
                    self._miss(track)
                else:
                    self._correct(track, detections[j], stamp_ns)
            free = [j for j in free if j not in taken.values()]
        self._confirm()
        self.tracks = [track for track in self.tracks if track.misses < self._patience(track)]
        self._create([detections[j] for j in free], stamp_ns)
        return self.confirmed

    def _predict(self, dt_s: float) -> None:
        c = self._config
        transition = np.array([[1.0, dt_s, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        kick_m, kick_mps = c.sigma_acceleration_mps2 * 0.5 * dt_s**2, c.sigma_acceleration_mps2 * dt_s
        turn_rad = c.sigma_azimuth_rate_radps * dt_s
        process = np.array(
            [[kick_m**2, kick_m * kick_mps, 0.0], [kick_m * kick_mps, kick_mps**2, 0.0], [0.0, 0.0, turn_rad**2]]
        )
        for track in self.tracks:
            track.state, track.covariance = predict(track.state, track.covariance, F=transition, Q=process)

    def _associate(self, tracks: list[Track], detections: list[Detection], free: list[int]) -> dict[int, int]:
        """Track index -> detection index, at least total distance, within the gate."""
        if not tracks or not free:
            return {}
        cost = np.array([[self._distance(track, detections[j]) for j in free] for track in tracks])
        cost[cost > self._config.gate] = _FAR
        pairs = zip(*linear_sum_assignment(cost), strict=True)
        return {int(i): free[int(j)] for i, j in pairs if cost[i, j] < _FAR}

    def _taken_by_another_reading(
        self, track: Track, group: list[Track], taken: dict[int, int], detections: list[Detection]
    ) -> int | None:
        """The detection that another reading of the same body was given, if this reading explains it as well."""
        for i, j in taken.items():
            same = track.origin == group[i].origin and not track.confirmed
            if same and self._distance(track, detections[j]) <= self._config.gate:
                return j
        return None

    def _distance(self, track: Track, detection: Detection) -> float:
        """Squared Mahalanobis distance between predicted and measured (range, velocity, azimuth)."""
        measured, noise = self._measurement(track, detection)
        n = len(measured)
        residual = measured - track.state[:n]
        _, weighed, _ = dposv(track.covariance[:n, :n] + noise, residual)  # positive definite: by Cholesky
        return float(residual @ weighed)

    def _measurement(self, track: Track, detection: Detection) -> tuple[np.ndarray, np.ndarray]:
        """The measurement with its velocity unfolded to the nearest alias of the track's, and its covariance."""
        span = 2 * self._v_max_mps
        folds = round((track.velocity_mps - detection.velocity_mps) / span)
        values = list(self._unfolded(detection, folds))
        if detection.azimuth_rad is not None:
            values.append(detection.azimuth_rad)
        n = len(values)
        return np.array(values), self._noise[:n, :n]

    def _correct(self, track: Track, detection: Detection, stamp_ns: int) -> None:
        if not track.confirmed:
            track.misfit += self._distance(track, detection)
        measured, noise = self._measurement(track, detection)
        observe = _OBSERVE[: len(measured)]
        track.state, track.covariance = update(track.state, track.covariance, measured, noise, observe)
        track.seen_m = float(measured[RANGE])
        track.snr_db = detection.snr_db
        track.has_azimuth |= detection.azimuth_rad is not None
        track.age += 1
        track.misses = 0
        track.measured, track.strongest = measured, detection.strongest
        self._judge(track, stamp_ns)

    def _judge(self, track: Track, stamp_ns: int) -> None:
        """The approach gate: so many closing frames in a row open it, as many others shut it."""
        if track.velocity_mps <= -self._config.moving_mps:
            track.closing, track.not_closing = track.closing + 1, 0
        else:
            track.closing, track.not_closing = 0, track.not_closing + 1
        if track.closing >= self._config.approach_frames:
            track.approaching = True
            track.last_approach_ns = stamp_ns
        elif track.not_closing >= self._config.approach_frames:
            track.approaching = False

    def _confirm(self) -> None:
        """Number the tracks that have been seen for long enough; of several readings of one body the one that fits.

        The ranges of some frames have to prefer one reading clearly. Until then none is reported; if they never do,
        the speed counts as it was measured: an echo that stands is not made fast by its alias alone.
        """
        waiting: dict[int, list[Track]] = {}
        for track in self.tracks:
            if not track.confirmed and track.misses == 0:
                waiting.setdefault(track.origin, []).append(track)
        for readings in waiting.values():
            chosen = self._choose(sorted(readings, key=lambda track: track.misfit))
            if chosen is None:
                continue
            chosen.track_id, self._next_id = self._next_id, self._next_id + 1
            for other in readings:
                other.misses += 0 if other is chosen else self._config.delete_misses

    def _choose(self, readings: list[Track]) -> Track | None:
        """The reading to believe, the best comes first; None = not yet."""
        best = readings[0]
        if best.age < self._config.confirm_frames:
            return None
        clear = len(readings) == 1 or readings[1].misfit - best.misfit >= self._config.alias_margin
        if clear and (best.folds == 0 or not self._shown_as_standing(best) or self._has_come_as_far(best)):
            return best
        if best.age < self._config.alias_frames:
            return None
        as_measured = next((track for track in readings if track.folds == 0), None)
        return as_measured or (None if self._shown_as_standing(best) else best)

    def _shown_as_standing(self, track: Track) -> bool:
        """As fast as a whole turn of the Doppler axis: the echo itself looks as if it stood."""
        return abs(track.velocity_mps - track.folds * 2 * self._v_max_mps) < self._config.moving_mps

    def _has_come_as_far(self, track: Track) -> bool:
        """Its ranges since it began tell its speed from two thirds of that. A reflector whose strongest cell wanders
        from bin to bin moves too, but not as fast as the alias of its Doppler says."""
        began_ns, began_m = track.began
        way_m = track.velocity_mps * ((self._stamp_ns or began_ns) - began_ns) * 1e-9
        tolerance_m = 3 * np.sqrt(2) * self._config.sigma_range_m
        return abs(way_m) >= 3 * tolerance_m and abs(track.seen_m - began_m - way_m) <= tolerance_m

    def _miss(self, track: Track) -> None:
        track.misses += 1
        track.measured = track.strongest = None
        track.closing = 0  # the gate starts over; an alarm that runs goes on

    def _patience(self, track: Track) -> int:
        """Misses that end a track: before confirmation frames have to be consecutive."""
        return self._config.delete_misses if track.confirmed else 1

    def _create(self, detections: list[Detection], stamp_ns: int) -> None:
        """New tracks from what is left, unless it is a part of a body that has been seen in this frame."""
        for detection in detections:
            if any(track.misses == 0 and self._same_body(track, detection) for track in self.tracks):
                continue
            azimuth = detection.azimuth_rad
            covariance = self._noise.copy()
            if azimuth is None:
                covariance[AZIMUTH, AZIMUTH] = _UNKNOWN_AZIMUTH_VARIANCE
            self._next_origin += 1
            for folds, (range_m, velocity_mps) in self._aliases(detection).items():
                state = np.array([range_m, velocity_mps, azimuth or 0.0])
                track = Track(state, covariance.copy(), detection.snr_db, azimuth is not None)
                track.folds, track.origin, track.began = folds, self._next_origin, (stamp_ns, range_m)
                self._judge(track, stamp_ns)
                self.tracks.append(track)
        if self._config.confirm_frames == 1:
            self._confirm()

    def _aliases(self, detection: Detection) -> dict[int, tuple[float, float]]:
        """(range, velocity) by fold for every speed that shows up as this one: a reading each."""
        reach = int((self._config.max_speed_mps + self._v_max_mps) / (2 * self._v_max_mps))
        every = {fold: self._unfolded(detection, fold) for fold in range(-reach, reach + 1)}
        return {fold: pair for fold, pair in every.items() if fold == 0 or abs(pair[1]) <= self._config.max_speed_mps}

    def _unfolded(self, detection: Detection, folds: int) -> tuple[float, float]:
        """(range, velocity) of a detection whose speed has gone round so many times."""
        extra_mps = folds * 2 * self._v_max_mps
        return detection.range_m - extra_mps * self._range_lead_s, detection.velocity_mps + extra_mps

    def _same_body(self, track: Track, detection: Detection) -> bool:
        turned_rad = 0.0
        if track.azimuth_rad is not None and detection.azimuth_rad is not None:
            turned_rad = abs(track.azimuth_rad - detection.azimuth_rad)
        return (
            abs(track.range_m - detection.range_m) <= self._body.body_range_m
            and abs(track.velocity_mps - detection.velocity_mps) <= self._body.body_velocity_mps
            and turned_rad <= self._body.body_azimuth_rad
        )
