"""The proving ground as an instrument: it repeats itself, its cases are what they claim, it tells the truth."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from services.jetson.fusion.config import RulesConfig
from spotter_sim.model import Scenario
from spotter_sim.motion import Standing
from spotter_tools.cli.__main__ import app
from spotter_tools.prove import run
from spotter_tools.prove.case import BEGINS_S, OUT, PRESETS, Case
from spotter_tools.prove.catalogue import all_cases, subset
from spotter_tools.prove.dangers import car_stopped, child_behind_car, pedestrian_crossing, thing
from spotter_tools.prove.ground import prove
from spotter_tools.prove.innocents import parked_rows
from spotter_tools.prove.kept import kept
from spotter_tools.prove.loop import drive
from spotter_tools.prove.table import lines
from spotter_tools.prove.yardstick import measure, visible

CASES = all_cases()
runner = CliRunner()


def short(case: Case, ends_s: float = BEGINS_S + 1.0) -> Case:
    return replace(case, ends_s=ends_s)


def test_the_catalogue_is_large_and_has_every_condition():
    assert len(CASES) >= 300
    assert len({case.name for case in CASES}) == len(CASES)
    assert {case.out for case in CASES} == set(OUT)
    assert {case.preset for case in CASES} == set(PRESETS)
    assert {tag for case in CASES for tag in case.tags} == {"dusk", "rain"}
    assert {case.ego for case in CASES} == {True, False}
    assert 20 <= len(subset()) <= 60
    assert {case.dangerous for case in subset()} == {True, False}
    assert {case.dangerous for case in kept()} == {True, False}


@pytest.mark.parametrize("case", CASES[: len(CASES) // 2 : 14], ids=lambda case: case.name)
def test_dangerous_cases_end_in_a_contact_and_innocent_ones_do_not(case):
    assert (measure(short(case, case.ends_s)).contact_s is not None) == case.dangerous


def test_the_child_is_not_known_before_it_can_be_seen():
    case = child_behind_car(2.0)
    yardstick = measure(case)
    assert yardstick.avoidable
    assert yardstick.known_s is not None
    scenario: Scenario = case.scenario
    assert 1 not in {actor.actor_id for actor in visible(scenario.at(yardstick.known_s - 0.5)).actors}
    assert 1 in {actor.actor_id for actor in visible(scenario.at(yardstick.known_s)).actors}


def test_a_case_beyond_physics_is_known_as_such():
    """Somebody who steps out a hand's breadth before the bumper."""
    case = pedestrian_crossing(4.0, "near", 50)
    late = replace(case.scenario.cast[0], motion=_Jump(0.35))
    assert not measure(replace(case, scenario=replace(case.scenario, cast=(late,)))).avoidable


class _Jump:
    """Beside the way until so long before the meeting, then in it."""

    def __init__(self, before_s: float) -> None:
        self._before_s = before_s

    def at(self, t_s):
        return Standing(0.1, 0.0 if t_s > BEGINS_S + 4.5 - self._before_s else -4.0).at(t_s)


def test_the_same_case_gives_the_same_log_and_another_seed_another_one():
    case = short(pedestrian_crossing(2.0, "far", 50), 2.0)
    first, second = drive(case), drive(case)
    assert first.log == second.log
    other = drive(replace(case, seed=1))
    assert [moment.verdict for moment in other.log] != [moment.verdict for moment in first.log]


@pytest.mark.parametrize("decider", ["spotter", "article"])
def test_a_car_that_stands_in_the_way_is_not_hit(decider):
    outcome = run(car_stopped(2.0), decider)
    assert not outcome.collided
    assert 0.0 < outcome.min_gap_m < 2.0
    assert outcome.first_caution_s is not None
    assert outcome.stopped_s is not None
    assert outcome.closing_mps == pytest.approx(2.0, abs=0.05)


def test_nobody_stops_for_what_no_sensor_can_see(tmp_path):
    """A pane that lets the laser through, and no radar: the instrument shows the collision, and draws it.

    At the speed to which fusion limits a vehicle whose sensors see some kinds of obstacle only.
    """
    blind = replace(thing(2.0, "glass wall"), out="radar")
    (result,) = prove([blind], 1, tmp_path)
    assert result.failed
    assert result.spotter.collided
    assert result.spotter.impact_mps == pytest.approx(RulesConfig().partial_mps, abs=0.1)
    assert result.spotter.min_gap_m == 0.0
    (picture,) = tmp_path.glob("*.png")
    assert picture.stat().st_size > 20_000
    text = "\n".join(lines([result]))
    assert "without radar" in text
    assert "1 cases failed" in text


def test_an_innocent_case_counts_every_alarm_as_false():
    outcome = run(short(parked_rows(2.0, 0.7), BEGINS_S + 5.0), "article")
    assert not outcome.collided
    assert outcome.false_alarm_s == outcome.alarm_s > 0.2
    assert outcome.false_brakes > 0


def test_the_command_writes_json(tmp_path):
    said = runner.invoke(app, ["prove", "--only", "thin pole, 1 m/s, dusk", "--jobs", "1", "--out", str(tmp_path)])
    results = json.loads((tmp_path / "results.json").read_text())
    assert [one["family"] for one in results] == ["thin pole"]
    assert said.exit_code == (1 if results[0]["spotter"]["collided"] else 0)
    assert "the article's rules" in said.output


def test_no_such_case():
    refused = runner.invoke(app, ["prove", "--only", "unicorn"])
    assert refused.exit_code == 2
    assert "no case has 'unicorn' in its name" in refused.output
