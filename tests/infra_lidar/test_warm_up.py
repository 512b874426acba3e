"""What is warmed up before the first real frame, so that none has to wait for a kernel."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numba
import pytest

from services.infra_lidar import compile_together, features, warm_up, warm_up_parts
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.feature_spacing import cluster_spacing
from services.infra_lidar.features import SPACING
from services.infra_lidar.kernels_ground import find_known, look
from services.infra_lidar.tracking import MultiObjectTracker
from services.infra_lidar.warm_up_parts import LATER

ROOT = Path(__file__).parents[2]


def test_the_people_of_the_warm_up_end_in_one_cluster_that_is_cut():
    tracker = MultiObjectTracker(InfraLidarConfig().tracking)
    warm_up_parts.follow_people(tracker)
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
    warm_up_parts.know_people(Classifier(InfraLidarConfig().classifier, replace(shipped, features=names)))
    assert 2 in searched


def test_whoever_is_free_takes_the_next_part_until_none_is_left(monkeypatch: pytest.MonkeyPatch):
    taken: list[str] = []
    parts = {name: partial(lambda name, config: taken.append(name), name) for name in "abcd"}
    monkeypatch.setattr(compile_together, "PARTS", parts)
    numbers = compile_together.pipe_of([0, 1, 3])
    assert compile_together.work_off(numbers, InfraLidarConfig()) == ["a", "b", "d"] == taken
    assert compile_together.work_off(numbers, InfraLidarConfig()) == []
    os.close(numbers)


HELPER = """
import os, sys
{before}
if __name__ == "__main__":
    from services.infra_lidar import compile_together
    names = ("first", "later")
    compile_together.PARTS = {{name: lambda config, name=name: open(name, "w").close() for name in names}}
    compile_together.main()
"""


@pytest.mark.parametrize(("before", "complaint"), [("", []), ("sys.exit(3)", ["exit code 3"])])
def test_helpers_say_when_they_are_done_and_go_on(before, complaint, tmp_path, monkeypatch, caplog):
    """``first`` is left to a helper here; ``later`` is compiled when nobody waits any more."""
    script = tmp_path / "helper.py"
    script.write_text(HELPER.format(before=before))
    begun: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def begin(words: list[str], **how: Any) -> subprocess.Popen[bytes]:
        words = [words[0], str(script), *words[3:]]
        begun.append(popen(words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, **how))
        return begun[0]

    monkeypatch.setattr(subprocess, "Popen", begin)
    monkeypatch.setattr(compile_together, "work_off", lambda numbers, config: [])
    monkeypatch.setattr(compile_together, "PARTS", {"first": None, "later": None})
    monkeypatch.setattr(
        os, "sched_getaffinity", lambda _: {0}
    )  # a helper nevertheless: nobody is to wait for ``later``
    compile_together.compile_together(InfraLidarConfig(), ("later",))
    assert [word for record in caplog.records for word in complaint if word in record.getMessage()] == complaint
    assert (tmp_path / "first").exists() == (not complaint)
    begun[0].wait(60)
    assert (tmp_path / "later").exists() == (not complaint)


def test_without_a_learned_scene_nobody_waits_for_what_it_needs(monkeypatch: pytest.MonkeyPatch):
    waited_for: list[tuple[str, ...]] = []
    monkeypatch.setattr(warm_up, "_compiled_before", lambda: False)
    monkeypatch.setattr(warm_up, "compile_together", lambda config, later: waited_for.append(later))
    warm_up.warm_up(InfraLidarConfig(), print, learned=False)
    warm_up.warm_up(InfraLidarConfig(), print, learned=True)
    assert waited_for == [LATER, ()]


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
from services.infra_lidar import compile_together, features, warm_up, warm_up_parts
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
for compile_part in warm_up_parts.PARTS.values():
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
