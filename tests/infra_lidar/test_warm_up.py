"""After the warm-up no frame waits for the compiler; where compiled kernels are kept."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from services.infra_lidar import jit
from services.infra_lidar import warm_up as warming
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.jit import CACHE, cache_folder, copy_shipped
from services.infra_lidar.tracking.tracker import MultiObjectTracker
from services.infra_lidar.warm_up import CLUSTERS, kinds_that_may_come, second_compiler, track_two_people, warm_up

WHAT_FRAMES_COMPILE = """
import sys
from benchmarks.infra_lidar.frames import revolutions
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig
from services.infra_lidar.input.ouster import OusterFormat, decode
from services.infra_lidar.input.revolution import stack_packets
from services.infra_lidar.input.velodyne import Vls128Parser
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.warm_up import warm_up
from tests.infra_lidar.made_packets import metadata, ouster_packet, revolutions_of

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("services.infra_lidar")]
    values = {id(value): value for module in modules for value in vars(module).values()}.values()
    return {f"{v.__name__}{types}" for v in values if hasattr(v, "signatures") for types in v.signatures}

warm_up(InfraLidarConfig(), lambda text: None)
before = compiled()
config = InfraLidarConfig(background=BackgroundConfig(learn_s=0.5, min_frames=5))
of_packets = revolutions_of(Vls128Parser())
of_points, of_ranges = InfraLidarPipeline(config), InfraLidarPipeline(config)
for k, frame in enumerate(revolutions(3, objects=12, count=12, columns=600)):
    of_points.process(k * 10**8, frame.points)
    of_ranges.process(k * 10**8, frame.image)
InfraLidarPipeline(config).process(0, of_packets[0].range_image)
layout = OusterFormat(metadata())
decode(layout, stack_packets([ouster_packet(layout, 1, 0)]))
print(len(before) > 10, *sorted(compiled() - before))
"""


def test_frames_after_the_warm_up_compile_nothing():
    finished = subprocess.run([sys.executable, "-c", WHAT_FRAMES_COMPILE], capture_output=True, text=True, check=False)
    assert finished.stdout.split("\n")[0] == "True", finished


@pytest.mark.parametrize(
    ("source", "kinds"),
    [
        ("", {"velodyne", "ouster", "hesai", "robosense"}),
        ("ros2:/points?type=x", {"velodyne", "ouster", "hesai", "robosense"}),
        ("ouster://10.0.0.5", {"ouster"}),
        ("sim:crossing", set()),
        ("file:a.pcap", set()),
    ],
)
def test_decoders_are_compiled_for_what_may_come_live(source: str, kinds: set[str]):
    assert set(kinds_that_may_come(source)) == kinds


def test_a_second_warm_up_loads_what_the_first_has_compiled():
    messages: list[str] = []
    warm_up(InfraLidarConfig(), messages.append)
    warm_up(InfraLidarConfig(), messages.append)
    assert messages[-1] == "loading kernels"


def test_the_second_compiler_ends_by_itself_and_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    started: list[subprocess.Popen[bytes]] = []

    class Noted(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, command: list[str], **options: object) -> None:
            super().__init__(command, **options)  # type: ignore[call-overload]
            started.append(self)

    monkeypatch.setattr(warming.subprocess, "Popen", Noted)
    monkeypatch.setattr(warming.os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(warming, "KEPT", True)
    monkeypatch.setattr(warming, "DONE", tmp_path / "complete")
    with second_compiler() as beside:
        assert beside
        assert started[0].args == [sys.executable, "-m", "services.infra_lidar.warm_up", CLUSTERS]
    assert started[0].returncode == 0
    (tmp_path / "complete").touch()
    warm_up(InfraLidarConfig(), lambda _: None)
    assert len(started) == 1  # all is compiled


def test_the_two_people_of_the_warm_up_end_in_one_cluster_that_is_divided():
    tracker = MultiObjectTracker(InfraLidarConfig().tracking)
    track_two_people(tracker)
    assert [track.state for track in tracker.messages()] == ["confirmed", "confirmed"]
    assert list(tracker.matches.values()) == [0, 0]


def test_a_child_process_keeps_its_kernels_where_its_parent_does():
    command = [sys.executable, "-c", "from services.infra_lidar.jit import CACHE; print(CACHE)"]
    child = subprocess.run(command, capture_output=True, text=True, check=True, env=dict(os.environ))
    assert child.stdout.strip() == os.environ["NUMBA_CACHE_DIR"] == str(CACHE)


def test_changed_sources_get_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(jit, "PACKAGE", tmp_path)
    folders = set()
    for name, text in (("a.py", "x = 1"), ("a.py", "x = 2"), ("room/b.py", ""), ("a.txt", "")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
        folders.add(cache_folder(tmp_path / "cache"))
    assert len(folders) == 3
    assert {cache_folder(folder).parent for folder in folders} == {tmp_path / "cache" / "kernels"}


def test_kernels_of_an_image_are_copied_once(tmp_path: Path):
    folder = cache_folder(tmp_path / "cache")
    copy_shipped(tmp_path / "image", folder)
    assert not folder.exists()
    shipped = cache_folder(tmp_path / "image") / "room_1f"
    shipped.mkdir(parents=True)
    (shipped / "kernel.nbi").write_bytes(b"first")
    copy_shipped(tmp_path / "image", folder)
    (shipped / "kernel.nbi").write_bytes(b"second")
    copy_shipped(tmp_path / "image", folder)
    assert (folder / "room_1f" / "kernel.nbi").read_bytes() == b"first"
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_a_folder_that_takes_no_files_is_told_and_not_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert jit.takes_files(tmp_path / "new")
    assert list((tmp_path / "new").iterdir()) == []
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # as on a full disk
    try:
        assert not jit.takes_files(tmp_path / "full")
        (tmp_path / "full" / jit.COMPLETE).touch()
        assert jit.takes_files(tmp_path / "full")  # all is there: nothing is written
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    (tmp_path / "file").touch()
    assert not jit.takes_files(tmp_path / "file" / "below")
    assert ["File too large" in caplog.messages[0], "Not a directory" in caplog.messages[1]] == [True, True]
