"""How well the carriageway is found on random streets with kerbs, crowns and ramps, from masts of 3 to 15 m.

    python -m benchmarks.infra_lidar.streets [FIRST LAST]

Seeds below 1200 served to set the method's constants; the figures quoted are of others. The prior is the true pitch to
the nearest 5 degrees, then the same with the wrong sign.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from services.infra_lidar.calibration.plane_fit import Calibration, Calibrator
from services.infra_lidar.config import CalibrationConfig
from spotter_sim.lidar128 import scan
from spotter_sim.scene import Scene
from spotter_sim.street import street

SEEDS, COLUMNS = range(2000, 2150), 1200


@dataclass(frozen=True)
class Outcome:
    """One street: how far off the normal is, what was said of it, and what was refused."""

    off_deg: float
    stated_deg: float
    height_off_m: float
    refused: str

    @classmethod
    def of(cls, found: Calibration, scene: Scene) -> Outcome:
        """The calibration against the truth of the scene."""
        cosine = float(np.clip(found.normal @ scene.road_normal_sensor, -1.0, 1.0))
        off_deg = float(np.degrees(np.arccos(cosine)))
        return cls(off_deg, found.error_deg, abs(found.height_m - scene.sensor_height_m), found.refused)


def outcomes(seeds: range, prior_of: Callable[[float], float]) -> list[Outcome]:
    """One revolution of each street, calibrated with the prior that ``prior_of`` makes of the true pitch, degrees."""
    found = []
    for seed in seeds:
        scenario = street(seed)
        prior_deg = prior_of(float(np.degrees(scenario.scene.mount.pitch_rad)))
        calibrator = Calibrator(CalibrationConfig(prior_pitch_deg=prior_deg))
        found.append(Outcome.of(calibrator.add(scan(scenario, 5.0, COLUMNS).xyz), scenario.scene))
    return found


def rounded(pitch_deg: float, sign: float = 1.0) -> float:
    """The prior that somebody writes down: to the nearest 5 degrees."""
    return float(np.clip(sign * 5.0 * round(pitch_deg / 5.0), -90.0, 90.0))


def summary(name: str, found: list[Outcome]) -> str:
    """One line: errors of the accepted, how many were refused, how often the stated error covers the true one."""
    accepted = [outcome for outcome in found if not outcome.refused]
    off = np.array([outcome.off_deg for outcome in accepted] or [np.nan])
    covered = np.mean([outcome.off_deg <= outcome.stated_deg for outcome in accepted] or [np.nan])
    stated = np.median([outcome.stated_deg for outcome in accepted] or [np.nan])
    height_m = max((outcome.height_off_m for outcome in accepted), default=np.nan)
    return (
        f"  {name:16} {len(found)} streets: median {np.median(off):.3f}, 95 % {np.percentile(off, 95):.3f}, worst "
        f"{off.max():.3f} deg, over 0.5 deg {(off > 0.5).sum()}, height off by at most {height_m * 100:.1f} cm, "
        f"refused {len(found) - len(accepted)}; stated {stated:.3f}, covers {covered:.1%}"
    )


def main() -> None:
    """The command above."""
    seeds = range(int(sys.argv[1]), int(sys.argv[2])) if len(sys.argv) > 2 else SEEDS
    print("carriageway at the foot, degrees")
    print(summary("prior right", outcomes(seeds, rounded)))
    print(summary("sign wrong", outcomes(seeds, partial(rounded, sign=-1.0))))


if __name__ == "__main__":
    main()
