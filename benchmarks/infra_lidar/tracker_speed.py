"""The tracker against a plain nested-loop version of the article's, on the same detections, in the same run.

"update" is one frame of ``MultiObjectTracker.step``. "+ messages" makes the list of ``ObjectTrack`` for the network as
well: half of that is 36 Python floats of covariance for each track. Processor time of one thread; best and median over
the frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment

from services.infra_lidar.config import TrackingConfig
from services.infra_lidar.tracking import Detections, MultiObjectTracker

FRAMES, WARM_UP = 80, 10
TARGET_MS = {100: 0.2, 300: 1.0}


class PlainTracker:
    """Constant velocity, one track at a time and one solve per pair, as straightforward code has it."""

    def __init__(self) -> None:
        self.tracks: list[tuple[np.ndarray, np.ndarray]] = []

    def update(self, positions: np.ndarray, dt_s: float = 0.1) -> None:
        """One frame of centres (K, 3), metres."""
        F, H = np.eye(6) + dt_s * np.eye(6, k=3), np.eye(3, 6)
        Q, R = np.diag([0.5] * 3 + [2.0] * 3), 0.3 * np.eye(3)
        predicted = [(F @ x, F @ P @ F.T + Q) for x, P in self.tracks]
        cost = np.full((len(predicted), len(positions)), 1e6)
        for t, (x, P) in enumerate(predicted):
            for d, z in enumerate(positions):
                y, S = z - H @ x, H @ P @ H.T + R
                d2 = y @ np.linalg.solve(S, y)
                if d2 <= 7.81:
                    cost[t, d] = np.sqrt(d2)
        rows, columns = linear_sum_assignment(cost)
        for t, d in zip(rows, columns, strict=True):
            if cost[t, d] < 1e6:
                x, P = predicted[t]
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
                predicted[t] = (x + K @ (positions[d] - H @ x), (np.eye(6) - K @ H) @ P)
        used = set(columns[cost[rows, columns] < 1e6].tolist())
        born = [
            (np.r_[positions[d], 0, 0, 0], np.diag([0.5] * 3 + [10.0] * 3))
            for d in range(len(positions))
            if d not in used
        ]
        self.tracks = predicted + born


def scene(count: int, frame: int) -> Detections:
    """``count`` cars at the density of a busy junction, each on its way."""
    rng = np.random.default_rng(count)
    side = 60.0 * np.sqrt(count / 100)
    place, speed = rng.uniform(-side, side, (count, 2)), rng.uniform(-8, 8, (count, 2))
    noise = np.random.default_rng([count, frame]).normal(0, 0.08, (count, 2))
    position = np.column_stack((place + 0.1 * frame * speed + noise, np.ones(count)))
    yaw = np.arctan2(speed[:, 1], speed[:, 0])
    return Detections(position, np.tile([4.5, 1.8, 1.5], (count, 1)), yaw, ["car"] * count, np.full(count, 0.9))


def _timed(step: Callable[[int, Detections], object], frames: list[Detections]) -> tuple[float, float]:
    """Best and median milliseconds of processor time a frame, after the warm-up."""
    times = []
    for number, frame in enumerate(frames):
        start = time.thread_time()
        step(number, frame)
        times.append(1e3 * (time.thread_time() - start))
    kept = times[min(WARM_UP, len(times) - 1) :]
    return min(kept), float(np.median(kept))


def main() -> None:
    """Print best and median ms for 40, 100 and 300 tracks, and the ratio to the plain version."""
    print(f"{'tracks':>8}{'plain ms':>10}{'update ms':>18}{'+ messages ms':>18}{'ratio':>8}{'target':>8}")
    for count in (40, 100, 300):
        frames = [scene(count, number) for number in range(FRAMES)]
        silent, whole = MultiObjectTracker(TrackingConfig()), MultiObjectTracker(TrackingConfig())
        update = _timed(lambda i, f, t=silent: t.step((i + 1) * 100_000_000, f.records()), frames)
        message = _timed(lambda i, f, t=whole: t.update((i + 1) * 100_000_000, f), frames)
        plain = PlainTracker()
        plain_ms = _timed(lambda _, f, t=plain: t.update(f.position_m), frames[: 4 if count > 100 else 10])[0]
        target = TARGET_MS.get(count, "")
        ours = "".join(f"{best:9.3f} /{median:6.3f} " for best, median in (update, message))
        print(f"{count:8d}{plain_ms:10.2f}{ours}{plain_ms / update[0]:8.0f}{target:>8}")


if __name__ == "__main__":
    main()
