"""What several tests of the simulator share."""

from __future__ import annotations

import numpy as np
import pytest

from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Straight
from spotter_sim.scene import Ground, Mount, Scene, post
from spotter_sim.solids import Solids


def _one_actor(kind, x_m, y_m, yaw_rad=np.pi, speed_mps=0.0, fixtures: Solids | None = None):
    """A scenario with one actor that passes (x, y) at t = 0, on flat ground, with a far post as the only fixture."""
    scene = Scene(Ground(), fixtures or post(-300.0, 0.0, 0.0, 1.0), Mount(x_m=0.0, y_m=0.0))
    return Scenario("alone", 10.0, scene, (Player(1, kind, Straight((x_m, y_m), yaw_rad, speed_mps, 10.0)),))


@pytest.fixture
def one_actor():
    return _one_actor
