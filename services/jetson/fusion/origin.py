"""What a verdict rests on: live, recorded, emulated or simulated data. Pure."""

from __future__ import annotations

from common.messages import SourceKind, least_live
from services.jetson.fusion.evidence import Claim, FusionInputs


def rests_on(inputs: FusionInputs, claims: tuple[Claim, ...]) -> SourceKind:
    """The least live of what was weighed: every sensor that is not out, whether or not it tipped the scales, alarms
    that are held for a sensor that is out, and the vehicle's motion.
    """
    holding = {claim.by for claim in claims}
    weighed = [s.source_kind for name, s in inputs.witnesses.items() if s.state != "disconnected" or name in holding]
    return least_live(weighed + ([inputs.motion_kind] if inputs.motion_kind and weighed else []))
