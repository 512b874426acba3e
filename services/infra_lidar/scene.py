"""A frame parted into what was always there, the road, and the rest, which goes on to be clustered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from services.infra_lidar.background import Background, BackgroundModel, Known, Sifted
from services.infra_lidar.blindness import Seen
from services.infra_lidar.buffers import Buffers
from services.infra_lidar.calibration import Calibration
from services.infra_lidar.calibration_keeper import CalibrationKeeper
from services.infra_lidar.classes import BACKGROUND
from services.infra_lidar.clustering import ClusterPoints
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.ground import Ground, Levelled, Obstacles
from services.infra_lidar.kernels_returns import beams_seen
from services.infra_lidar.range_image import Returns, count_of, points_of, sample_of
from services.infra_lidar.structure import StructureMap

SURE = 0.7  # from this confidence on a road user speaks against what is seen in its place being background
WATCH_EVERY = 13  # of the points, odd: so that every beam is among them


@dataclass(frozen=True, eq=False)
class Parted:
    """frame: the points to work on, level frame, valid until the next frame. seen: what counts.

    known: what is not among them, None where all N returns are. is_ground: (N,) bool, or (M,) of the returns that are
    not known.
    """

    frame: Obstacles
    seen: Seen
    known: Known | None
    is_ground: np.ndarray

    @property
    def sifted(self) -> bool:
        """Whether some returns were known."""
        return self.known is not None

    @cached_property
    def ground(self) -> np.ndarray:
        """(N,) bool."""
        if self.known is None:
            return self.is_ground
        ground = self.known.road.copy()
        ground[self.known.fresh] = self.is_ground
        return ground

    @property
    def background(self) -> np.ndarray:
        """(N,) bool, returns of the learned fixed scene."""
        return np.zeros(len(self.is_ground), bool) if self.known is None else self.known.mask


class Scene:
    """Road surface and background of one sensor. One thread at a time."""

    def __init__(
        self, config: InfraLidarConfig, keeper: CalibrationKeeper, buffers: Buffers, stored: BackgroundModel | None
    ) -> None:
        self._config = config
        self._keeper = keeper
        self.ground = Ground(config.ground, buffers, config.blindness.near_m)
        self._structure = StructureMap(config.clustering, config.ground.range_max_m)
        self.background = Background(config.background, buffers, self._of_these_grids(stored))
        self._beams = np.zeros(256, bool)
        self._beam_count, self._sector_count = 0, 0
        self._complete = True

    def part(self, stamp_ns: int, returns: Returns, calibration: Calibration, complete: bool = True) -> Parted:
        """Part the returns of a turn; nothing is left where the calibration is refused.

        ``complete``: the whole circle is there; only then the sensor is compared with what it saw before.
        """
        self._complete = complete and not calibration.refused
        if calibration.refused:
            nothing = self.ground.remove(points_of(returns)[:0], calibration.T_level_sensor)
            seen = Seen(count_of(returns), 0, 0, 0)
            return Parted(nothing, seen, None, np.zeros(len(returns), bool))
        sifted = self._sift(returns)
        if sifted is None:
            return self._whole(stamp_ns, returns, calibration)
        return self._rest(stamp_ns, returns, sifted, calibration)

    def learn(self, stamp_ns: int, returns: Returns, parted: Parted, road_user: np.ndarray) -> np.ndarray | None:
        """Teach the background a whole frame; road_user (N,) float32: how sure it is that a point is of a road user.

        Returns (N,) bool, the points that are background from now on, when this frame ended the learning; else None.
        """
        ready = self._config.background.enabled and self._keeper.settled and self._complete
        if not ready or parted.sifted:
            return None
        if self.background.lost:
            self.background.restart()
        if self.background.model is not None:
            return None
        users = self.background.learn(stamp_ns, returns, parted.ground, road_user >= SURE, self.ground.surface)
        if self.background.model is None or users is None:
            return None
        drawn = self._structure.draw(parted.frame, (road_user > 0.0) | users)  # who is not sure to be one may go, too
        self.background.model = replace(self.background.model, structure=drawn)
        sifted = self.background.sift(returns, self._config.blindness.near_m)
        if sifted is None:
            return np.zeros(len(returns), bool)
        return Known(returns, self.background.model, sifted.source).mask

    def mark_structure(self, parted: Parted, found: ClusterPoints, ground_z_m: np.ndarray, classes: np.ndarray) -> None:
        """Call clusters of a sifted frame that lie within fixed structure background, in classes (K,) int64; of a whole
        frame none do."""
        model = self.background.model
        if parted.sifted and model is not None and model.structure.size:
            self._structure.mark(model.structure, found, ground_z_m, BACKGROUND, classes)

    def restart(self) -> None:
        """Forget the background: the sensor has been moved or turned."""
        self.background.restart()

    def _of_these_grids(self, stored: BackgroundModel | None) -> BackgroundModel | None:
        """A stored background, unless it was learned with other cells of the ground or of the clusters."""
        if stored is None or stored.surface.shape != self.ground.surface.shape:
            return None
        return stored if self._structure.drawn_by_this(stored.structure) else None

    def _sift(self, returns: Returns) -> Sifted | None:
        if not self._config.background.enabled or not self._keeper.settled:
            return None
        self.background.recognise(returns)
        return self.background.sift(returns, self._config.blindness.near_m)

    def _whole(self, stamp_ns: int, returns: Returns, calibration: Calibration) -> Parted:
        points = points_of(returns)
        frame = self.ground.remove(points, calibration.T_level_sensor)
        self._look_after(stamp_ns, sample_of(returns, WATCH_EVERY), frame)
        seen = Seen(frame.returns, frame.near, self._beam_count, self._sector_count)
        return Parted(frame, seen, None, frame.ground)

    def _rest(self, stamp_ns: int, returns: Returns, sifted: Sifted, calibration: Calibration) -> Parted:
        assert self.background.model is not None
        if self._keeper.due(stamp_ns):  # now and then what is known is looked at, too
            sample = sample_of(returns, WATCH_EVERY)
            self._look_after(stamp_ns, sample, self.ground.look(sample, calibration.T_level_sensor))
        found = self.ground.remove_known(
            sifted.fresh, sifted.source, calibration.T_level_sensor, self.background.model.surface
        )
        seen = Seen(sifted.returns, sifted.near, self._beam_count, self._sector_count)
        known = Known(returns, self.background.model, sifted.source)
        return Parted(found, seen, known, found.ground)

    def _look_after(self, stamp_ns: int, sample: np.ndarray, frame: Levelled) -> None:
        """Count the beams of a sample and the directions of a frame or of the sample, and watch for a nudge."""
        if not self._complete:
            return
        self._beam_count = int(beams_seen(sample[:, 4], self._beams)) if sample.shape[1] > 4 else 0
        self._sector_count = self.ground.sectors_seen
        self._keeper.look_after(stamp_ns, frame)
