"""Comparing two services, and succession between instances: pure functions on made messages."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from common.bus.presence import claimants, successor
from common.messages import ObjectTrack, ObjectTracks, RadarTrack, RadarTracks, SensorHealth, SystemHealth
from common.topics import INFRA_TRACKS, RADAR_TRACKS
from spotter_tools.cli import swap as swap_command
from spotter_tools.cli.__main__ import app
from spotter_tools.swap.candidate import Predecessor, command_line
from spotter_tools.swap.compare import Limits, Received, compare, in_common, refuse
from spotter_tools.swap.order import Outcome, Refused
from spotter_tools.swap.run import _start
from spotter_tools.swap.switchover import Switchover
from spotter_tools.swap.taps import primary
from spotter_tools.swap.watch import by_sender, flaps, lost, measure_switchover


def radar(t_s: float, *ranges_m: float, level: Any = "SAFE", latency_s: float = 0.02, **more: Any) -> Received:
    tracks = [
        RadarTrack(
            track_id=i, range_m=range_m, azimuth_rad=0.0, velocity_mps=-1.0, age_frames=9, approaching=True,
            moving=True, ttc_s=None, level=level, snr_db=20.0,
        )
        for i, range_m in enumerate(ranges_m)
    ]  # fmt: skip
    stamp_ns = round(t_s * 1e9)
    message = RadarTracks(
        stamp_ns=stamp_ns, sent_ns=stamp_ns + round(latency_s * 1e9), tracks=tracks, level=level, settled=True,
        noise_floor_db=-60.0, **more,
    )  # fmt: skip
    return Received(message, t_s + latency_s)


def stream(count: int = 50, period_s: float = 0.1, start_s: float = 1000.0, **how: Any) -> list[Received]:
    return [radar(start_s + i * period_s, 5.0 - 0.02 * i, **how) for i in range(count)]


def verdict_on(candidate: list[Received]) -> list[str]:
    return refuse(compare(RADAR_TRACKS, 5.0, stream(), candidate), Limits())


@pytest.mark.parametrize(
    ("candidate", "expected"),
    [
        (stream(start_s=1000.03), ""),
        ([], "it published nothing"),
        (stream(25, 0.2), "5.0 Hz, the live one 10.0 Hz"),
        (stream(latency_s=0.3), "latency 300 ms (95 %), allowed 80 ms"),
        (stream(start_s=2000.0), "none of its messages has the time of a live one"),
        ([radar(1000.0 + 0.1 * i) for i in range(50)], "only 0% of the objects in common"),
        (stream(state="degraded", reason="sees nothing"), "it says: sees nothing"),
    ],
    ids=["as good", "silent", "slow", "late", "another time", "blind", "degraded"],
)
def test_a_worse_candidate_is_refused_with_the_reason(candidate: list[Received], expected: str) -> None:
    reasons = verdict_on(candidate)
    assert (not reasons) if not expected else any(expected in reason for reason in reasons), reasons


def test_a_candidate_that_warns_less_is_refused_and_one_that_warns_more_is_not() -> None:
    live = stream(level="CAUTION")
    limits = Limits()
    less = compare(RADAR_TRACKS, 5.0, live, stream(level="SAFE"))
    more = compare(RADAR_TRACKS, 5.0, live, stream(level="IMMINENT"))
    assert less.weaker == 1.0
    assert any("a lower level" in reason for reason in refuse(less, limits))
    assert more.stronger == 1.0
    assert not refuse(more, limits)


@pytest.mark.parametrize(("late_s", "weaker"), [(0.2, 0.0), (0.3, 0.02), (1.0, 0.16)])
def test_a_level_that_comes_a_little_later_is_no_lower_level(late_s: float, weaker: float) -> None:
    def approach(begins_s: float) -> list[Received]:
        return [radar(1000.0 + 0.1 * i, 5.0, level="IMMINENT" if 0.1 * i > begins_s else "SAFE") for i in range(50)]

    found = compare(RADAR_TRACKS, 5.0, approach(2.05), approach(2.05 + late_s))
    assert (found.weaker, found.stronger) == (weaker, 0.0)


def test_objects_are_matched_once_and_nearest_first() -> None:
    assert in_common(radar(0.0, 3.0, 3.5).message, radar(0.0, 3.4).message) == pytest.approx(2 / 3)
    assert in_common(radar(0.0).message, radar(0.0).message) is None


def test_tracks_of_the_roadside_are_matched_by_position() -> None:
    def at(x_m: float) -> ObjectTracks:
        track = ObjectTrack(
            track_id=1, label="car", label_confidence=1.0, position_m=[x_m, 0.0, 0.0], velocity_mps=[0.0] * 3,
            covariance=[[0.0] * 6] * 6, size_m=[4.0, 2.0, 1.5], yaw_rad=0.0, age_s=1.0, score=1.0, state="confirmed",
            points=50,
        )  # fmt: skip
        return ObjectTracks(stamp_ns=1, tracks=[track])

    assert in_common(at(10.0), at(11.0)) == 1.0
    assert in_common(at(10.0), at(15.0)) == 0.0


def test_succession_is_in_the_token() -> None:
    new = successor("new", "old")
    assert claimants({"old", new}) == {new}
    assert claimants({"old", "other"}) == {"old", "other"}
    assert claimants({"old", new, "other"}) == {new, "other"}
    third = successor("third", new)
    assert claimants({new, third}) == {third}
    assert claimants({successor("a", "b"), successor("b", "a")})  # nonsense is a conflict, not absence


def test_gaps_and_flaps_are_counted() -> None:
    before, old = stream(10), stream(3, start_s=1001.0)
    seen = measure_switchover("radar", before, old, stream(10, start_s=1001.6), [], [])
    assert seen.longest_gap_ms == pytest.approx(400.0)
    assert seen.change_ms == pytest.approx(400.0)
    assert (seen.missed, seen.missed_before) == (3, 0)
    assert flaps([(0.0, "SAFE"), (1.0, "CAUTION"), (1.3, "SAFE"), (5.0, "CAUTION"), (9.0, "SAFE")]) == 1


def test_what_is_told_twice_or_late_makes_up_for_nothing() -> None:
    """Both speak for half a second, and one measurement of the time after that is missing."""
    old, new = stream(6), stream(6, start_s=1000.03) + stream(10, start_s=1000.73)
    new[-1] = Received(new[-1].message, new[-1].arrived_s + 0.3)  # late, not missed
    seen = measure_switchover("radar", stream(20, start_s=998.0), old, new, [], [])
    assert seen.change_ms == pytest.approx(-470.0)
    assert seen.missed == 1
    assert seen.longest_gap_ms == pytest.approx(400.0)


def health(at_s: float, state: Any) -> Received:
    sensor = SensorHealth(state=state, reason="", since_ns=0, age_ms=1.0, rate_hz=10.0)
    return Received(SystemHealth(stamp_ns=1, sensors={"radar": sensor}, colour="green", summary="", services={}), at_s)


def test_what_was_so_before_is_no_fault_of_the_switchover() -> None:
    before, new = stream(20), stream(20, start_s=1002.0)
    states = [health(1000.0 + 0.2 * i, "degraded" if i in (3, 6, 15) else "online") for i in range(20)]
    seen = measure_switchover("radar", before, [], new, [], states)
    assert (seen.health_flaps, seen.health_flaps_before) == (1, 2)


def numbered(*numbers: int) -> list[Received]:
    said = [radar(1000.0 + 0.05 * i) for i in range(len(numbers))]
    for received, seq in zip(said, numbers, strict=True):
        received.message.seq = seq
    return said


@pytest.mark.parametrize(
    ("live", "by_new"),
    [
        ((501, 502, 31, 503, 32, 33), [31, 32, 33]),
        ((501, 503, 32, 34), [32, 34]),
        ((501, 502), []),
        ((501, *range(31, 520)), [*range(31, 520)]),
        ((31, 32), [31, 32]),
    ],
    ids=["both", "some lost", "nothing of the new one", "past the old one's end", "nothing more of the old one"],
)
def test_who_spoke_is_known_by_whose_numbers_go_on(live: tuple[int, ...], by_new: list[int]) -> None:
    old, new = by_sender(numbered(*live), last_old=500, last_new=30)
    assert [received.message.seq for received in new] == by_new
    assert lost(new) == sum(b - a - 1 for a, b in pairwise(by_new))
    assert len(old) + len(new) == len(live)


def test_two_with_the_same_numbers_are_told_apart_once_both_speak() -> None:
    assert not by_sender(numbered(31, 32, 33), last_old=30, last_new=30)[1]
    assert len(by_sender(numbered(31, 31, 32, 32), last_old=30, last_new=30)[1]) == 2


def test_the_topic_that_counts_is_the_one_others_decide_on() -> None:
    assert primary("radar") is RADAR_TRACKS
    assert primary("infra_lidar") is INFRA_TRACKS
    assert primary("dashboard").product == "status"


def test_only_our_own_programs_are_told_by_options(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = command_line("/opt/bin/spotter-radar --config a.toml", "pi0", "tcp/127.0.0.1:7447", "spotter")
    assert ours[:3] == ["/opt/bin/spotter-radar", "--config", "a.toml"]
    assert "host=pi0" in ours
    sibling = str(Path(sys.executable).with_name("spotter-radar"))
    monkeypatch.setenv("PATH", "")
    assert command_line("spotter-radar", "pi0", "tcp/127.0.0.1:7447", "spotter")[0] == sibling
    assert command_line("python theirs.py", "pi0", "tcp/127.0.0.1:7447", "spotter") == ["python", "theirs.py"]


@contextmanager
def process(*more: str) -> Iterator[subprocess.Popen[bytes]]:
    """A program that waits, with nothing of ours in its environment; ``more`` are further words."""
    with subprocess.Popen([sys.executable, "-c", "input()", *more], stdin=subprocess.PIPE, env={}) as waiting:
        yield waiting
        waiting.kill()


def test_another_program_that_has_the_number_of_a_service_elsewhere_is_left_alone() -> None:
    with process() as stranger, process("spotter-radar") as ours:
        assert not Predecessor("radar", stranger.pid, "", "").reachable
        assert Predecessor("radar", ours.pid, "", "").reachable
        assert Predecessor("radar", stranger.pid, "systemctl stop spotter-radar", "").reachable


def switchover(predecessor: Predecessor, tmp_path: Path) -> Switchover:
    """A candidate that has just been promoted, as ``Switchover`` sees it."""
    received = stream(5)
    tap = SimpleNamespace(since=lambda _: received, wait=lambda *_: True)
    presence = SimpleNamespace(instances=lambda: {("pi0", "radar", "new-after-old")})
    taps: Any = SimpleNamespace(
        live=tap, shadow=tap, verdicts=tap, health=tap, presence=presence, wait_instances=lambda *_: True,
        promoted=False,
    )  # fmt: skip
    order: Any = SimpleNamespace(service="radar", log=tmp_path / "log", probation_s=1.0, limits=Limits())
    candidate: Any = SimpleNamespace(
        promote=lambda: None, stop=lambda: None, ended=lambda: "it ended with code 1", live=None, pid=1
    )
    old: Any = SimpleNamespace(instance="old")
    return Switchover(order, taps, old, predecessor, candidate, compare(RADAR_TRACKS, 5.0, received, received), print)


@pytest.mark.parametrize("stop", ["false", "/no/such/systemctl stop spotter-radar"])
def test_a_service_that_cannot_be_stopped_is_a_refusal(stop: str, tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"old cannot be stopped: .*(non-zero exit status 1|/no/such/systemctl)"):
        switchover(Predecessor("radar", 1, stop, ""), tmp_path).run()


def test_a_service_that_ended_by_itself_meanwhile_is_no_reason_to_end_its_successor_too(tmp_path: Path) -> None:
    with process("spotter-radar") as dead:
        predecessor = Predecessor("radar", dead.pid, "", "/no/such/systemctl start spotter-radar")
    outcome = switchover(predecessor, tmp_path).run()
    assert outcome.reasons[0] == "it ended with code 1"
    assert outcome.reasons[-1] == (
        "the old service could not be started again and no process replaces it: start it yourself"
    )


def test_a_log_that_cannot_be_written_is_named_instead_of_the_candidate(tmp_path: Path) -> None:
    order: Any = SimpleNamespace(
        host="pi0",
        connect="tcp/127.0.0.1:1",
        namespace="spotter",
        candidate=sys.executable,
        log=tmp_path / "no" / "log",
    )
    old: Any = SimpleNamespace(instance="old")
    predecessor: Any = SimpleNamespace(inherited={})
    with pytest.raises(Refused, match=f"--log {order.log}: No such file or directory"):
        _start(order, old, predecessor)


@pytest.mark.parametrize(("kept", "promoted", "code"), [(0, True, 0), (2, True, 2), (0, False, 1), (2, False, 2)])
def test_the_exit_code_is_that_of_the_process_it_minded(
    monkeypatch: pytest.MonkeyPatch, kept: int, promoted: bool, code: int
) -> None:
    live = SimpleNamespace(process=SimpleNamespace(pid=1))
    monkeypatch.setattr(swap_command, "run_swap", lambda *_: (Outcome(promoted=promoted), live))
    monkeypatch.setattr(swap_command, "bus", lambda *_: nullcontext())
    monkeypatch.setattr(swap_command, "keep", lambda *_: kept)
    monkeypatch.setattr(swap_command.signal, "signal", lambda *_: None)
    result = CliRunner().invoke(app, ["swap", "radar", "--candidate", "spotter-radar", "--namespace", "spotter"])
    assert result.exit_code == code, result.output
