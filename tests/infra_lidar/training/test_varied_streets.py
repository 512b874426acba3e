"""Streets of randomised bodies: seeded, who stands where the plan says, of the class it says."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.training.varied_streets import varied_street
from spotter_sim.roadside import roadside
from spotter_sim.solids import KINDS, SCENE_ID


def test_a_seed_makes_the_same_street() -> None:
    one, again, other = varied_street(3, 20, "open"), varied_street(3, 20, "open"), varied_street(4, 20, "open")
    np.testing.assert_array_equal(one.scene.fixtures.centre_m, again.scene.fixtures.centre_m)
    assert len(one.scene.fixtures) != len(other.scene.fixtures)


def test_bodies_stand_where_the_plan_puts_them_and_keep_their_kind() -> None:
    plan, street = roadside(5, 30, "level"), varied_street(5, 30, "level").scene.fixtures
    for actor in plan.at(0.5 * plan.length_s).actors:
        mine = street.take(street.owner == actor.actor_id)
        assert {KINDS[kind] for kind in mine.kind} == {actor.kind}
        away_m = np.linalg.norm(mine.centre_m[:, :2] - actor.position_m[:2], axis=1)
        assert away_m.min() < 3.0
        assert away_m.max() < 20.0


def test_furniture_is_of_nobody_and_more_than_the_plan_has() -> None:
    plan, street = roadside(5, 30, "level"), varied_street(5, 30, "level").scene.fixtures
    assert np.sum(street.owner == SCENE_ID) > len(plan.scene.fixtures) + 40
    assert set(street.owner) == {SCENE_ID, *(player.actor_id for player in plan.cast)}
