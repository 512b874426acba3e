"""R4: for how long, and for what, an empty picture may hold back a CAUTION of the lidar.

Only what nobody has confirmed, never IMMINENT, and only for ``suppression_limit_s`` of one detection. What has been
used comes back after the lidar has been clear for ``suppression_refill_s``, not at the next gap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import RANK, FusionInputs, Suppression

if TYPE_CHECKING:
    from services.jetson.fusion.verdict import Votes


def draw_on(inputs: FusionInputs, votes: Votes, budget: Suppression, rules: RulesConfig) -> Suppression:
    """The budget after these inputs."""
    lidar = votes["lidar"]
    if lidar is None:  # out: neither clear nor seeing
        return budget._replace(clear_s=None)
    if lidar == "SAFE":
        clear_s = inputs.now_s if budget.clear_s is None else budget.clear_s
        full = not 0.0 <= inputs.now_s - clear_s < rules.suppression_refill_s
        return Suppression(clear_s=clear_s) if full else budget._replace(clear_s=clear_s)
    farthest_m = max((d for d in (inputs.lidar.nearest_m, budget.farthest_m) if d is not None), default=None)
    return Suppression(
        since_s=inputs.now_s if budget.since_s is None else budget.since_s,
        farthest_m=farthest_m,
        spent=budget.spent or _is_confirmed(inputs, votes, farthest_m, rules),
    )


def _is_confirmed(inputs: FusionInputs, votes: Votes, farthest_m: float | None, rules: RulesConfig) -> bool:
    """Imminent, closing in, or seen by anybody else: no noise."""
    nearest_m = inputs.lidar.nearest_m
    closing = nearest_m is not None and farthest_m is not None and farthest_m - nearest_m >= rules.suppression_closing_m
    shared = any(RANK[level] >= RANK["CAUTION"] for name, level in votes.items() if name not in ("lidar", "camera"))
    return votes["lidar"] == "IMMINENT" or closing or shared or votes["camera"] is not None


def is_suppressed(inputs: FusionInputs, votes: Votes, budget: Suppression, rules: RulesConfig) -> bool:
    """A lidar CAUTION that nobody shares, with every sensor online, a fresh empty picture, and budget left."""
    if rules.suppression == "off" or votes["lidar"] != "CAUTION" or budget.spent:
        return False
    if any(level != "SAFE" for name, level in votes.items() if name not in ("lidar", "camera", "infra_lidar")):
        return False
    if any(sensor.state != "online" for sensor in inputs.sensors.values()):
        return False
    if votes["camera"] is not None or not camera_is_fresh(inputs, rules):
        return False
    if rules.suppression == "full":
        return True
    since_s = inputs.now_s if budget.since_s is None else budget.since_s
    return 0.0 <= inputs.now_s - since_s < rules.suppression_limit_s


def camera_is_fresh(inputs: FusionInputs, rules: RulesConfig) -> bool:
    """Online, and recent enough to confirm or to suppress (A20)."""
    age_s = inputs.camera.age_s
    return inputs.camera.state == "online" and age_s is not None and abs(age_s) <= rules.confirm_age_s
