"""Segmentation of a frame into background, road, and obstacles, which go on to be clustered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from services.infra_lidar.calibration.monitor import CalibrationMonitor
from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.classification.classes import BACKGROUND
from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.range_image import Returns, count_of, points_of, sample_of
from services.infra_lidar.segmentation.background import Background, BackgroundMask, BackgroundModel, Foreground
from services.infra_lidar.segmentation.ground import Ground, Levelled, Obstacles
from services.infra_lidar.segmentation.static_map import MapCells, Occupancy
from services.infra_lidar.sensor_health import FrameStatistics

MIN_SHARE = 0.6  # of a cluster's points that must lie within fixed things
ROAD_USER_CONFIDENCE = 0.5  # a cluster that may be a road user keeps its place from becoming background; unknown is 0.5
SAMPLE_EVERY = 13  # of the points; an odd step, so that every beam is among them
WATCH_EVERY = 4  # frames between looks at what the sensor sees
DROPS_EVERY = 40  # frames between looks for drops: the ground of a fixed sensor does not change


@dataclass(frozen=True, eq=False)
class Segmentation:
    """A frame of N returns or places of a range image.

    obstacles: what is neither background nor ground, level frame. statistics: what the sensor's health is judged by.
    background_mask: None for a whole frame, of which no background was subtracted.
    """

    obstacles: Obstacles
    statistics: FrameStatistics
    background_mask: BackgroundMask | None

    @property
    def background_subtracted(self) -> bool:
        """Whether the fixed scene has been taken away."""
        return self.background_mask is not None

    @cached_property
    def ground(self) -> np.ndarray:
        """(N,) bool, returns of the road."""
        if self.background_mask is None:
            return self.obstacles.is_ground
        ground = self.background_mask.road.copy()
        ground[self.background_mask.foreground] = self.obstacles.is_ground
        return ground

    @property
    def background(self) -> np.ndarray:
        """(N,) bool, returns of the learned fixed scene."""
        if self.background_mask is None:
            return np.zeros(len(self.obstacles.is_ground), bool)
        return self.background_mask.mask


class Scene:
    """Road surface and background of one sensor. One thread at a time.

    stored: background of an earlier run. It is dropped if it was learned with other grids.
    """

    def __init__(self, config: InfraLidarConfig, monitor: CalibrationMonitor, stored: BackgroundModel | None) -> None:
        self._config = config
        self._monitor = monitor
        self.ground = Ground(config.ground, config.visibility.near_m)
        self._map_cells = MapCells(config.clustering, config.ground.range_max_m)
        self._occupancy: Occupancy | None = None  # while the background is learned
        self.background = Background(config.background, self._on_these_grids(stored))
        self._drops, self._drops_age = np.zeros(self.ground.surface.shape[:2], bool), DROPS_EVERY
        self._beams, self._sectors, self._unwatched = 0, 0, WATCH_EVERY
        self._complete = True

    def segment(self, stamp_ns: int, returns: Returns, calibration: Calibration, complete: bool = True) -> Segmentation:
        """Segment the returns of a revolution; there are no obstacles while the calibration is refused.

        ``complete``: the whole circle is there; only then the sensor is compared with what it saw before.
        """
        self._complete = complete and not calibration.refused
        if calibration.refused:
            return _without_obstacles(returns)
        foreground = self._subtract_background(returns)
        if foreground is None:
            return self._segment_whole(stamp_ns, returns, calibration)
        return self._segment_foreground(stamp_ns, returns, foreground, calibration)

    def learn(
        self, stamp_ns: int, returns: Returns, segmentation: Segmentation, passing: np.ndarray, parked: np.ndarray
    ) -> np.ndarray | None:
        """Teach the background a whole frame.

        passing, parked: (N,) float32 confidence that a point is of a road user, if it is there now and then, and if it
        is there all the time.

        Returns (N,) bool, the points that are background from now on, when this frame ended the learning; else None.
        """
        ready = self._config.background.enabled and self._monitor.settled and self._complete
        if not ready or segmentation.background_subtracted:
            return None
        if self.background.lost:
            self.restart()
        if self.background.model is not None:
            return None
        self._occupancy = self._occupancy or Occupancy(self._map_cells)
        self._occupancy.add(segmentation.obstacles, parked)
        is_road_user = passing >= ROAD_USER_CONFIDENCE
        self.background.learn(stamp_ns, returns, segmentation.ground, is_road_user, self.ground.surface)
        if self.background.model is None:
            return None
        self.background.model = replace(
            self.background.model, static_map=self._occupancy.static_map(), drops=self._drops
        )
        self._occupancy = None
        foreground = self.background.subtract_background(returns, self._config.visibility.near_m)
        if foreground is None:
            return np.zeros(len(returns), bool)
        return BackgroundMask(returns, self.background.model, foreground.index).mask

    def mark_static(self, segmentation: Segmentation, clusters: ClusterPoints, classes: np.ndarray) -> None:
        """Write background into classes (K,) int64 where clusters lie within fixed things.

        Does nothing in frames from which no background was subtracted.
        """
        model = self.background.model
        if segmentation.background_subtracted and model is not None and model.static_map.size:
            share = self._map_cells.share_within(model.static_map, clusters)
            classes[share >= MIN_SHARE] = BACKGROUND

    def on_drop(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """(K,) bool: positions in the level frame where no vehicle can stand: the ground lies well below the road."""
        if not self._drops.any():
            return np.zeros(len(x_m), bool)
        return np.asarray(self._drops[self.ground.cells_at(x_m, y_m)])

    def restart(self) -> None:
        """Forget the background: the sensor has been moved or turned."""
        self.background.restart()
        self._occupancy, self._drops_age = None, DROPS_EVERY

    def _on_these_grids(self, stored: BackgroundModel | None) -> BackgroundModel | None:
        """A stored background, unless it was learned with other cells of the ground or of the clusters."""
        if stored is None or stored.surface.shape != self.ground.surface.shape:
            return None
        if stored.drops.shape != stored.surface.shape[:2]:
            return None
        return stored if self._map_cells.fits(stored.static_map) else None

    def _subtract_background(self, returns: Returns) -> Foreground | None:
        if not self._config.background.enabled or not self._monitor.settled:
            return None
        self.background.match_stored_model(returns)
        return self.background.subtract_background(returns, self._config.visibility.near_m)

    def _segment_whole(self, stamp_ns: int, returns: Returns, calibration: Calibration) -> Segmentation:
        levelled = self.ground.level_only(points_of(returns), calibration.T_level_sensor)
        obstacles = self.ground.remove_levelled(levelled)
        self._drops_age += 1
        if self._drops_age >= DROPS_EVERY and self._complete:
            self._drops, self._drops_age = self.ground.find_drops(levelled), 0
        self._unwatched += 1
        if self._unwatched >= WATCH_EVERY or self._monitor.due(stamp_ns):
            self._watch_sensor(stamp_ns, sample_of(returns, SAMPLE_EVERY), levelled, SAMPLE_EVERY)
        return Segmentation(
            obstacles, FrameStatistics(levelled.returns, levelled.near, self._beams, self._sectors), None
        )

    def _segment_foreground(
        self, stamp_ns: int, returns: Returns, foreground: Foreground, calibration: Calibration
    ) -> Segmentation:
        model, T = self.background.model, calibration.T_level_sensor
        assert model is not None
        self._drops = model.drops
        if self._monitor.due(stamp_ns):  # the calibration is checked on the road, which is background
            sample = sample_of(returns, SAMPLE_EVERY)
            self._watch_sensor(stamp_ns, sample, self.ground.level_only(sample, T))
        obstacles = self.ground.remove_ground_with_map(foreground.points, foreground.index, T, model.surface)
        statistics = FrameStatistics(foreground.returns, foreground.near, self._beams, self._sectors)
        return Segmentation(obstacles, statistics, BackgroundMask(returns, model, foreground.index))

    def _watch_sensor(self, stamp_ns: int, sample: np.ndarray, levelled: Levelled, every: int = 1) -> None:
        """Count the beams in a sample of the points and the sectors of levelled points; watch for a nudge.

        every: only every ``every``-th levelled point is counted for the sectors.
        """
        if not self._complete:
            return
        self._unwatched = 0
        self._beams = _beams_in(sample)
        self._sectors = self.ground.sectors_seen(levelled.cell[::every])
        if self._monitor.due(stamp_ns):
            self._monitor.monitor(stamp_ns, np.stack((levelled.x, levelled.y, levelled.z), axis=1))


def _without_obstacles(returns: Returns) -> Segmentation:
    empty = Obstacles(np.empty((0, 4), np.float32), np.empty(0, np.int32), np.zeros(len(returns), bool))
    return Segmentation(empty, FrameStatistics(count_of(returns), 0, 0, 0), None)


def _beams_in(points: np.ndarray) -> int:
    """Number of different rings, the fifth column of (N, C) float32 points; 0 where there is none."""
    if points.shape[1] < 5:
        return 0
    return int(np.count_nonzero(np.bincount(points[:, 4].astype(np.uint8), minlength=1)))
