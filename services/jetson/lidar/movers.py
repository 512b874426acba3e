"""What moves over ground beside the way, and whether it will be in it: people and wheels, seen early enough to stop.

A lane alarms for what is in it. Somebody who walks into it a moment before the vehicle is there has to be seen while
he is still beside it. So returns are joined to small things that stand free, followed from scan to scan over ground by
a Kalman filter (constant velocity), and held against the vehicle's way. Only while the vehicle drives and its motion is
known: the article's rules have no such thing.

What stands seems to move where more of it comes into view; therefore only what is small, free on both sides and of the
same size from scan to scan is followed, and only what has left its place counts as moving. It seems to move, too, where
a bend begins or ends: between two scans the vehicle has turned by something between what the old and the new yaw rate
say. Half the difference is doubt, in every place by its distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from common.messages import Level, Motion
from common.path import MovingPoint, Path, carried, is_driving, pose_after
from services.jetson.lidar.config import LidarConfig, MoversSection
from services.jetson.lidar.filters import Returns


@dataclass(frozen=True)
class Thing:
    """Returns that stand together, vehicle's frame."""

    place_m: np.ndarray  # (2,) their middle
    ends_m: np.ndarray  # (2, 2) the first and the last of them, counter-clockwise
    size_m: float


@dataclass
class Mover:
    """A thing that is followed; its state is over ground, along the vehicle's axes of now."""

    state: np.ndarray  # (4,) place and velocity
    covariance: np.ndarray  # (4, 4)
    born_m: np.ndarray  # (2, 2) where its ends were first, carried along
    ends_m: np.ndarray  # (2, 2) where they were seen last
    size_m: float
    doubt_rad: float = 0.0  # of the vehicle's heading, summed up since it was born
    scans: int = 1
    misses: int = 0
    contact_s: float | None = None  # None = it passes, or is not known to move


class Movers:
    """Call ``update`` once per scan."""

    def __init__(self, config: LidarConfig) -> None:
        self._config: MoversSection = config.movers
        self._lidar = config
        self._movers: list[Mover] = []
        self._stamp_ns: int | None = None
        self._motion: Motion | None = None  # at the scan before
        self._held: tuple[int, Level, float] = (0, "SAFE", 0.0)  # until when, level, metres ahead

    def update(self, stamp_ns: int, returns: Returns, used: np.ndarray, motion: Motion | None) -> tuple[Level, float]:
        """The level of what will be in the way, and how far ahead of the bumper it is now.

        Args:
            used: (N,) bool, which of the returns are believed.
        """
        last_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        before, self._motion = self._motion, motion
        dt_s = 0.0 if last_ns is None else (stamp_ns - last_ns) * 1e-9
        if motion is None or not is_driving(motion, self._lidar.path):
            self._movers = []
            return "SAFE", 0.0
        if not 0.0 < dt_s <= self._lidar.persistence.max_gap_s:
            self._movers = []
        self._predict(before or motion, motion, dt_s)
        path, turn_s = Path(self._lidar.path, motion), len(returns.order) / self._lidar.scan.sample_rate_hz
        near = used & (returns.range_m <= reach_m(path, turn_s, self._config))
        self._associate(things_of(seen_now(returns, self._lidar, motion), returns, near, used, self._config))
        return self._judge(stamp_ns, path)

    def _predict(self, before: Motion, now: Motion, dt_s: float) -> None:
        """Carry all on to this scan: they move over ground, and the vehicle with its axes has moved."""
        turned, place = pose_after(_mean(before, now), np.array([dt_s]))
        doubt_rad = 0.5 * abs(now.yaw_rate_radps - before.yaw_rate_radps) * dt_s
        cos, sin = float(np.cos(turned[0])), float(np.sin(turned[0]))
        turn = np.array([[cos, sin], [-sin, cos]])
        F, G = np.eye(4), np.vstack([0.5 * dt_s**2 * np.eye(2), dt_s * np.eye(2)])
        F[:2, 2:] = dt_s * np.eye(2)
        R = np.kron(np.eye(2), turn)
        Q = self._config.acceleration_mps2**2 * G @ G.T
        for mover in self._movers:
            state = F @ mover.state
            state[:2] -= place[:, 0]
            mover.state = R @ state
            mover.covariance = R @ (F @ mover.covariance @ F.T + Q) @ R.T
            across_m = doubt_rad * np.array([-mover.state[1], mover.state[0]])
            mover.covariance[:2, :2] += np.outer(across_m, across_m)
            mover.doubt_rad += doubt_rad
            mover.born_m = (mover.born_m - place[:, 0]) @ turn.T
            mover.ends_m = (mover.ends_m - place[:, 0]) @ turn.T

    def _associate(self, things: list[Thing]) -> None:
        """Each follows the nearest thing within reach; what nobody follows is new."""
        free = list(range(len(things)))
        for mover in sorted(self._movers, key=lambda one: -one.scans):
            near = [(float(np.linalg.norm(things[i].place_m - mover.state[:2])), i) for i in free]
            distance_m, index = min(near, default=(np.inf, -1))
            if distance_m > self._config.gate_m:
                mover.misses += 1
                continue
            free.remove(index)
            self._correct(mover, things[index])
        self._movers = [mover for mover in self._movers if mover.misses <= self._config.misses]
        for i in free:
            covariance = np.diag([self._config.place_sigma_m**2] * 2 + [self._config.speed_sigma_mps**2] * 2)
            state = np.array([*things[i].place_m, 0.0, 0.0])
            self._movers.append(Mover(state, covariance, things[i].ends_m, things[i].ends_m, things[i].size_m))

    def _correct(self, mover: Mover, thing: Thing) -> None:
        mover.misses = 0
        if abs(thing.size_m - mover.size_m) > self._config.same_size_m:  # another part of it came into view
            mover.born_m, mover.scans, mover.doubt_rad = thing.ends_m, 0, 0.0
            mover.state = np.array([*thing.place_m, 0.0, 0.0])
            mover.covariance[2:, 2:] = self._config.speed_sigma_mps**2 * np.eye(2)
            mover.covariance[:2, 2:] = mover.covariance[2:, :2] = 0.0
        mover.ends_m, mover.size_m, mover.scans = thing.ends_m, thing.size_m, mover.scans + 1
        P, noise = mover.covariance, self._config.place_sigma_m**2 * np.eye(2)
        gain = P[:, :2] @ np.linalg.inv(P[:2, :2] + noise)
        mover.state = mover.state + gain @ (thing.place_m - mover.state[:2])
        mover.covariance = P - gain @ P[:2]

    def _judge(self, stamp_ns: int, path: Path) -> tuple[Level, float]:
        """The soonest contact decides; an alarm lasts until enough scans are without it."""
        config = self._config
        soonest: tuple[float, float] | None = None
        for mover in self._movers:
            comes = self._moves(mover, path) and self._comes(mover, path)
            mover.contact_s = self._contact_s(mover, path) if comes else None
            if mover.contact_s is not None and (soonest is None or mover.contact_s < soonest[0]):
                soonest = mover.contact_s, max(0.0, float(mover.state[0]) - path.config.front_m)
        imminent_s = due_s(path, config)
        level: Level = "SAFE"
        if soonest is not None:
            late = soonest[0] >= imminent_s
            level = "IMMINENT" if not late else "CAUTION" if soonest[0] < imminent_s + config.caution_lead_s else "SAFE"
        hold_ns = round(config.hold_s * 1e9)
        until_ns, held, ahead_m = self._held
        until_ns = min(until_ns, stamp_ns + hold_ns)  # the clock may have been set back since
        if soonest is not None and (level == "IMMINENT" or (level == "CAUTION" and held != "IMMINENT")):
            self._held = (stamp_ns + hold_ns, level, soonest[1])
        elif stamp_ns > until_ns:
            self._held = (0, level, soonest[1] if soonest else ahead_m)
        else:
            self._held = (until_ns, held, ahead_m)
        return self._held[1], self._held[2]

    def _moves(self, mover: Mover, path: Path) -> bool:
        """Followed for long enough, fast enough beyond doubt, and neither its middle nor an end is where it was.

        The middle of a wall seems to move as more or less of it is seen, but one of its ends stays. The end at the way
        is asked once more: abreast of the vehicle first and last change places.
        """
        config, speed = self._config, float(np.linalg.norm(mover.state[2:]))
        sigma = float(np.sqrt(mover.covariance[2, 2] + mover.covariance[3, 3]))
        middle_m = mover.ends_m.mean(axis=0) - mover.born_m.mean(axis=0)
        ends_m = np.linalg.norm(mover.ends_m - mover.born_m, axis=1)
        edge_m = _edge(mover.ends_m, path) - _edge(mover.born_m, path)
        left_m = min(float(np.linalg.norm(middle_m)), float(np.linalg.norm(edge_m)), float(ends_m.min()))
        left_m -= mover.doubt_rad * float(np.linalg.norm(mover.state[:2]))
        return mover.scans >= config.scans and speed >= max(config.slowest_mps, sigma) and left_m >= config.left_m

    def _comes(self, mover: Mover, path: Path) -> bool:
        """In the way already, or coming nearer to it beyond doubt: who walks along beside it wavers a little."""
        here, soon = mover.state[None, :2], mover.state[None, :2] + 0.1 * mover.state[None, 2:]
        (ahead, beside), (_, then) = path.locate(here), path.locate(soon)
        if bool(path.contains(ahead, beside, 0.5 * mover.size_m)[0]):
            return True
        nearer_mps = (abs(float(beside[0])) - abs(float(then[0]))) / 0.1
        return nearer_mps >= self._config.sure_sigmas * float(np.sqrt(np.linalg.eigvalsh(mover.covariance[2:, 2:])[-1]))

    def _contact_s(self, mover: Mover, path: Path) -> float | None:
        config, covariance = self._config, mover.covariance.copy()
        covariance[:2, :2] += (0.5 * mover.size_m / config.sigmas) ** 2 * np.eye(2)  # it is no point
        point = MovingPoint(mover.state[:2], mover.state[2:], covariance)
        return path.time_to_contact_s(point, config.horizon_s, config.sigmas)


def _mean(before: Motion, now: Motion) -> Motion:
    """The motion between two scans."""
    speed_mps = 0.5 * (before.speed_mps + now.speed_mps)
    return msgspec.structs.replace(
        now, speed_mps=speed_mps, yaw_rate_radps=0.5 * (before.yaw_rate_radps + now.yaw_rate_radps)
    )


def _edge(ends_m: np.ndarray, path: Path) -> np.ndarray:
    """(2,) the end that is nearest to the way."""
    return np.asarray(ends_m[np.abs(path.locate(ends_m)[1]).argmin()])


def seen_now(returns: Returns, config: LidarConfig, motion: Motion) -> np.ndarray:
    """(N, 2) returns in the vehicle's frame of the scan's end, free of its skew."""
    age_s = (len(returns.order) - 1 - returns.order) / config.scan.sample_rate_hz
    return carried(np.column_stack([returns.x_m + config.path.front_m, returns.y_m]), motion, age_s)


def due_s(path: Path, config: MoversSection) -> float:
    """How long before the contact of a vehicle that drives IMMINENT is due: never less than a stop takes."""
    return max(config.imminent_s, path.stopping_m / path.motion.speed_mps)


def reach_m(path: Path, turn_s: float, config: MoversSection) -> float:
    """How far away things are followed: from so far that IMMINENT is said when it is due.

    Before that come the turns in which nothing is said yet, and one more: the body shows up somewhere within a turn.
    """
    return max(config.range_m, path.motion.speed_mps * (due_s(path, config) + (config.scans + 1) * turn_s))


def things_of(
    points_m: np.ndarray, returns: Returns, near: np.ndarray, used: np.ndarray, config: MoversSection
) -> list[Thing]:
    """Small things with free air on both sides, from returns in counter-clockwise order; (N,) bool: near enough."""
    kept = np.flatnonzero(near)
    if len(kept) < config.points:
        return []
    apart = np.linalg.norm(np.diff(points_m[kept], axis=0), axis=1) > config.join_m
    found = []
    for group in np.split(kept, np.flatnonzero(apart) + 1):
        if len(group) < config.points:
            continue
        low, high = points_m[group].min(axis=0), points_m[group].max(axis=0)
        size_m = float(np.linalg.norm(high - low))
        if size_m <= config.size_m and _stands_free(group, returns, used, config.free_m):
            found.append(Thing(0.5 * (low + high), points_m[group[[0, -1]]], size_m))
    return found


def _stands_free(group: np.ndarray, returns: Returns, used: np.ndarray, free_m: float) -> bool:
    """The beams next to it end well behind it, or nowhere: nothing nearer hides a part of it."""
    for end, step in ((group[0], -1), (group[-1], 1)):
        for away in (1, 2):
            i = (end + away * step) % len(returns.range_m)
            if used[i] and returns.range_m[i] < returns.range_m[end] + free_m:
                return False
    return True
