"""The bars over made-up results: each can be missed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from spotter_tools.prove.bars import bars
from spotter_tools.prove.case import Outcome
from spotter_tools.prove.ground import Result
from spotter_tools.prove.yardstick import Yardstick

FINE = Outcome(False, 0.0, 0.4, 1.0, 2.0, 3.0, 2.0, 0.0, drive_s=360.0, closing_mps=2.0)
QUIET = Outcome(False, 0.0, 0.4, None, None, None, 0.0, 0.0, drive_s=360.0)
DANGER = Result("a", "car", "model", True, "none", True, (), Yardstick(8.0, 2.0, 5.0, True), FINE, FINE)
INNOCENT = Result("b", "yard", "model", False, "none", True, (), Yardstick(None, 0.0, None, True), QUIET, QUIET)
HIT = replace(FINE, collided=True, impact_mps=0.4)


def missed(*results: Result) -> list[str]:
    return [bar.text.strip().split(":")[0] for bar in bars(list(results)) if not bar.met]


def test_all_is_well():
    assert missed(DANGER, replace(DANGER, out="radar"), replace(DANGER, out="lidar+camera"), INNOCENT) == []


@pytest.mark.parametrize(
    ("results", "texts"),
    [
        ([DANGER] * 99 + [replace(DANGER, spotter=HIT)], []),
        ([DANGER] * 9 + [replace(DANGER, spotter=HIT)], ["all online"]),
        (
            [DANGER] * 99 + [replace(DANGER, spotter=replace(HIT, impact_mps=1.1))],
            ["the rest at less than half of the closing speed"],
        ),
        ([replace(DANGER, yardstick=Yardstick(8.0, 2.0, 7.9, False), spotter=HIT)], []),
        ([replace(DANGER, out="radar", spotter=HIT)], ["without radar"]),
        ([replace(DANGER, out="radar", spotter=replace(HIT, limited_mps=0.5))], []),
        ([replace(DANGER, out="lidar+radar", spotter=replace(FINE, over_limit_s=0.1))], ["two sensors out"]),
        ([replace(INNOCENT, spotter=replace(QUIET, false_brakes=2))], ["innocent"]),
        ([replace(INNOCENT, spotter=replace(QUIET, false_alarm_s=2.0))], ["yards"]),
        ([replace(INNOCENT, spotter=replace(QUIET, imminent_s=0.1))], ["and never IMMINENT"]),
    ],
)
def test_a_bar_is_missed(results, texts):
    assert missed(*results) == texts
