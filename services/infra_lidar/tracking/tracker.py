"""Multi-object tracking of labelled boxes: one frame is ``MultiObjectTracker.step``.

Lifetimes are seconds, not frames. No clock, no I/O: the time is ``stamp_ns``.
"""

from __future__ import annotations

import numpy as np

from common.messages import ObjectTrack
from services.infra_lidar.tracking.association import assign, gated_pairs
from services.infra_lidar.tracking.box_update import update_tracks
from services.infra_lidar.tracking.config import TrackingConfig, kernel_settings
from services.infra_lidar.tracking.detections import Detections
from services.infra_lidar.tracking.duplicates import initiators, merge_duplicate_tracks
from services.infra_lidar.tracking.kalman import TRACK, TRAIL, FrameTime, predict
from services.infra_lidar.tracking.management import initiate, judge_movement, manage_tracks, stop_lost_tracks
from services.infra_lidar.tracking.split_groups import split_groups
from services.infra_lidar.tracking.track_table import TrackTable, report


class MultiObjectTracker:
    """Tracks of all road users of one sensor; takes every frame in order.

    A detection labelled "background" updates a track, but initiates none. Track ids count up and begin at 10 000
    times the second of the day of the first frame, so that they differ after a restart and repeat in a replay.
    """

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._settings = kernel_settings(config)
        self._tracks = np.zeros(0, TRACK)
        self._next_id = -1
        self._stamp_ns = 0
        self._frame = 0
        self._trail_ns = np.zeros(TRAIL, np.int64)  # stamp of each slot of the trails
        self._source = np.zeros(0, np.int64)  # index in the caller's last frame of each detection, pieces included
        self.merged: dict[int, int] = {}  # id of each track merged in the last frame -> id of the track that lives on

    def update(self, stamp_ns: int, detections: Detections) -> list[ObjectTrack]:
        """One frame: ``step``, then ``messages``."""
        self.step(stamp_ns, detections.records())
        return self.messages()

    def step(self, stamp_ns: int, detections: np.ndarray) -> None:
        """One frame of detections (K,) ``DETECTION``. All tracks are dropped if ``stamp_ns`` is not later than the last
        one."""
        time, config, settings = self._begin(stamp_ns), self._config, self._settings
        tracks = self._tracks

        # 1. Predict every track to the time of this frame.
        stop_lost_tracks(tracks, stamp_ns)
        predict(tracks, time.dt_s, settings)

        # 2. Split clusters of people where their tracks are predicted.
        self._source = np.arange(len(detections))
        if config.split_groups and config.boxes == "visible":
            detections, self._source = split_groups(tracks, detections)

        # 3. Gate, then assign detections to tracks.
        matches = assign(gated_pairs(tracks, detections, settings))

        # 4. Update the matched tracks; judge which of all move.
        tracks["detection"] = -1
        update_tracks(tracks, detections, matches, time, settings)
        judge_movement(tracks, detections, time, settings)

        # 5. Confirm and end tracks; initiate new ones at the detections that are left.
        tracks = _select(tracks, manage_tracks(tracks, detections, time, config))
        free = initiators(tracks, detections, config)
        if len(free):
            tracks = np.concatenate((tracks, initiate(detections, free, self._next_id, time, config)))
            self._next_id += len(free)

        # 6. Merge tracks of one vehicle.
        into = merge_duplicate_tracks(tracks) if config.merge_duplicates else np.full(len(tracks), -1)
        ids, (removed,) = tracks["track_id"], np.nonzero(into >= 0)
        self.merged = dict(zip(ids[removed].tolist(), ids[into[removed]].tolist(), strict=True))
        self._tracks = _select(tracks, into < 0)

    def snapshot(self) -> TrackTable:
        """All tracks as of the last frame, as arrays."""
        return report(self._tracks, self._stamp_ns, self._config.min_vote)

    def messages(self) -> list[ObjectTrack]:
        """All tracks as of the last frame."""
        return self.snapshot().messages()

    @property
    def matches(self) -> dict[int, int]:
        """Track id -> index of its detection in the last frame; people in one cluster share it."""
        hit = self._tracks[self._tracks["detection"] >= 0]
        return dict(zip(hit["track_id"].tolist(), self._source[hit["detection"]].tolist(), strict=True))

    def forget(self, vanished: np.ndarray) -> None:
        """Drop standing tracks that will not be seen again, because the fixed scene has been learned.

        vanished: (K,) bool, detections of the last frame that are fixed scene from now on. Standing tracks of these,
        without a detection, or tentative are dropped: what remains visible of them would look as if it moved. For the
        same reason the other standing tracks begin a new trail. Tracks that are kept keep their ids.
        """
        of_detection = np.append(vanished[self._source], True)  # the last one is for tracks without a detection
        tracks = self._tracks
        gone = of_detection[tracks["detection"]] | ~tracks["confirmed"]
        self._tracks = tracks = _select(tracks, tracks["moving"] | ~gone)
        for name in ("frames", "hit_streak"):
            tracks[name][~tracks["moving"]] = 0

    def _begin(self, stamp_ns: int) -> FrameTime:
        if self._next_id < 0:
            self._next_id = (stamp_ns // 1_000_000_000 % 86_400) * 10_000 + self._config.first_id
        if stamp_ns <= self._stamp_ns:
            self._tracks = self._tracks[:0]
        dt_s = max(stamp_ns - self._stamp_ns, 0) * 1e-9
        self._stamp_ns = stamp_ns
        self._frame += 1
        slot = self._frame % TRAIL
        self._trail_ns[slot] = stamp_ns
        recent = np.count_nonzero(stamp_ns - self._trail_ns <= self._config.movement_s * 1e9)
        return FrameTime(stamp_ns, dt_s, slot, int(recent))


def _select(tracks: np.ndarray, kept: np.ndarray) -> np.ndarray:
    return tracks if kept.all() else tracks[kept]
