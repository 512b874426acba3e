"""What is warmed up before the first real frame, so that none has to wait for a kernel."""

import subprocess
import sys
from dataclasses import replace

import numba
import pytest

from services.infra_lidar import features, warm_up
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.feature_spacing import cluster_spacing
from services.infra_lidar.features import SPACING
from services.infra_lidar.kernels_ground import find_known, look
from services.infra_lidar.tracking import MultiObjectTracker


def test_the_people_of_the_warm_up_end_in_one_cluster_that_is_cut():
    tracker = MultiObjectTracker(InfraLidarConfig().tracking)
    warm_up.follow_people(tracker)
    assert [track.state for track in tracker.messages()] == ["confirmed", "confirmed"]
    assert list(tracker.matches.values()) == [0, 0]


def test_a_warm_start_has_run_what_comes_seldom():
    warm_up.warm_up(InfraLidarConfig(), print)
    told: list[str] = []
    warm_up.warm_up(InfraLidarConfig(), told.append)
    assert told == ["loading kernels"]
    assert find_known.signatures  # frames after the end of learning
    assert look.signatures  # the watch over the pole


def test_the_search_for_neighbours_is_ready_before_a_class_hangs_on_it(monkeypatch: pytest.MonkeyPatch):
    """Both people may be sure without it."""
    searched: list[int] = []
    monkeypatch.setattr(features, "cluster_spacing", lambda *a: searched.append(len(a[2])) or cluster_spacing(*a))
    shipped = Classifier(InfraLidarConfig().classifier).forest
    names = (SPACING, *[name for name in shipped.features if name != SPACING][1:])
    warm_up.know_people(Classifier(InfraLidarConfig().classifier, replace(shipped, features=names)))
    assert 2 in searched


@pytest.mark.parametrize("processors", range(1, 9))
def test_each_part_is_compiled_once(processors: int):
    shares = warm_up.shared_out(processors)
    assert len(shares) == min(processors, len(warm_up.PARTS))
    assert sorted(name for share in shares for name in share) == sorted(warm_up.PARTS)


def test_what_an_update_has_changed_is_compiled_with_a_word(monkeypatch: pytest.MonkeyPatch):
    def run_whole(config: InfraLidarConfig) -> None:
        numba.njit(lambda a: a + 1)(1)
        numba.njit(lambda a: a + 2)(1)

    monkeypatch.setattr(warm_up, "run_whole", run_whole)
    monkeypatch.setattr(warm_up, "_compiled_before", lambda: True)
    told: list[str] = []
    warm_up.warm_up(InfraLidarConfig(), told.append)
    assert told == ["loading kernels", "compiling the kernels that an update has changed: up to half a minute"]


ALL_PARTS = """
import sys
from services.infra_lidar import features, warm_up
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.config import BackgroundConfig, CalibrationConfig, InfraLidarConfig

def signatures():
    found = {}
    for module in [m for name, m in sys.modules.items() if name.startswith("services.infra_lidar")]:
        for value in vars(module).values():
            if hasattr(value, "signatures") and getattr(value, "_cache", None):
                found[value.__module__ + "." + value.__name__] = set(value.signatures)
    return found

small = InfraLidarConfig(
    background=BackgroundConfig(learn_s=0.1, min_frames=5, azimuth_cells=90),
    calibration=CalibrationConfig(frames=1, hypotheses=16),
)
for compile_part in warm_up.PARTS.values():
    compile_part(small)
before = signatures()
warm_up.run_whole(small)
for name, now in signatures().items():
    for signature in now - before.get(name, set()):
        print(name, signature)
"""


def test_the_parts_leave_nothing_to_be_compiled():
    finished = subprocess.run([sys.executable, "-c", ALL_PARTS], capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout == ""
