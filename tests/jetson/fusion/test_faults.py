"""Faulty and hostile data, and random sequences of faults, in simulated time: never a wrong SAFE, never a crash."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from common.bus.status import Report
from common.codec import DecodeError, decode, encode
from common.messages import RadarTracks
from common.topics import ONBOARD_SENSORS, SENSOR_TOPICS
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.evidence import RANK


def test_a_repeated_message_is_dropped_and_does_not_keep_a_sensor_young(bench: Any) -> None:
    message = bench.message("radar")
    bench.silent.add("radar")
    for _ in range(20):
        bench.receive(bench.key("radar"), message)
        bench.tick()
    assert bench.is_in("radar", "disconnected", "stale")
    assert bench.pipeline.bad_input["pi0/radar/tracks: repeated"] > 5


def test_an_overtaken_message_is_dropped(bench: Any) -> None:
    bench.levels["radar"] = "IMMINENT"
    late = bench.message("radar")
    bench.levels["radar"] = "SAFE"
    bench.run(0.2)
    bench.receive(bench.key("radar"), late)
    assert bench.tick().level == "SAFE"
    assert bench.pipeline.bad_input["pi0/radar/tracks: out of order"] == 1


def test_a_frozen_stamp_is_stale_although_messages_come(bench: Any) -> None:
    """A service that sends the same picture again and again."""
    frozen_ns = bench.message("camera").stamp_ns
    bench.silent.add("camera")
    for _ in range(30):
        message = bench.message("camera")
        message.stamp_ns = frozen_ns
        bench.receive(bench.key("camera"), message)
        bench.tick()
    assert bench.is_in("camera", "disconnected", "stale")


def test_a_sequence_that_jumps_ahead_or_goes_back_once_is_accepted(bench: Any) -> None:
    for jump in (10**9, 2**62, 0):
        bench.seq["radar"] = jump
        bench.run(0.3)
        assert bench.is_in("radar", "online")


def test_two_senders_on_one_key_are_noticed_and_their_alarms_count(bench: Any, messages: Any) -> None:
    """The forger says SAFE between the radar's own messages, under numbers of its own."""
    bench.levels["radar"] = "IMMINENT"
    for step in range(20):
        bench.run(0.1)
        forged = messages.radar(bench.now_ns, "SAFE")
        forged.seq = step
        bench.receive(bench.key("radar"), forged)
        bench.tick()
    assert bench.is_in("radar", "degraded", "two_claimants")
    assert "somebody else" in bench.sensor("radar").reason
    assert {verdict.level for verdict in bench.verdicts[-20:]} == {"IMMINENT"}, "held between the radar's own messages"
    bench.run(3.0)
    assert bench.is_in("radar", "online")


def test_two_senders_are_right_while_one_announced_that_it_takes_over(bench: Any, messages: Any) -> None:
    """On a busy machine the old process may take its time to end; whoever speaks on after that is a stranger."""
    successor = ("pi0", "radar", "new-after-radar")

    def both_speak(steps: int) -> None:
        for _ in range(steps):
            bench.run(0.1)
            other = messages.radar(bench.now_ns, "SAFE")
            bench.receive(bench.key("radar"), other)
            bench.tick()

    bench.instances |= {successor}
    both_speak(20)
    assert bench.is_in("radar", "online")
    bench.instances -= {("pi0", "radar", "radar")}
    both_speak(20)
    assert bench.is_in("radar", "degraded", "two_claimants")


def test_a_restart_is_not_a_second_sender(bench: Any) -> None:
    for instance in range(5):
        bench.kill("radar")
        bench.start("radar", f"instance {instance}")
        bench.run(0.4)
    assert bench.is_in("radar", "online")


def test_a_restarted_sensor_begins_a_new_sequence(bench: Any) -> None:
    bench.kill("radar")
    bench.run(0.2)
    bench.start("radar")
    bench.until(lambda: bench.is_in("radar", "online"), 0.5)


def test_a_sensor_delayed_over_its_limit_is_stale(bench: Any) -> None:
    bench.delay_s["lidar"] = 0.7
    bench.run(0.6)
    assert bench.is_in("lidar", "disconnected", "stale")
    assert "data comes late, it is 0." in bench.sensor("lidar").reason


@pytest.mark.parametrize("lie", ["level", "zone"])
def test_a_message_that_contradicts_itself_counts_as_its_worst_part(bench: Any, lie: str) -> None:
    message = bench.message("lidar")
    if lie == "level":
        message.level = "IMMINENT"
    else:
        message.left.level = "IMMINENT"
    bench.silent.add("lidar")
    bench.receive(bench.key("lidar"), message)
    assert bench.tick().level == "IMMINENT"


def test_a_radar_track_outweighs_the_level_of_its_message(bench: Any, messages: Any) -> None:
    message = messages.radar(bench.now_ns, "IMMINENT")
    message.level, message.seq = "SAFE", 10**6
    bench.receive(bench.key("radar"), message)
    assert bench.tick().level == "IMMINENT"


def test_another_hosts_name_is_counted_named_and_ignored(bench: Any, messages: Any) -> None:
    bench.kill("radar")
    for _ in range(10):
        bench.receive("pi7/radar/tracks", messages.radar(bench.now_ns))
        bench.tick()
    assert bench.is_in("radar", "disconnected")
    assert bench.pipeline.bad_input["pi7/radar/tracks: from an unexpected host"] == 10
    assert bench.pipeline.take_new_bad_input() == {"pi7/radar/tracks: from an unexpected host": 10}
    assert not bench.pipeline.take_new_bad_input()
    bench.run(0.5)
    assert any("pi7/radar/tracks: from an unexpected host" in note for note in bench.health.notes)


def test_a_thousand_strangers_fill_no_memory(bench: Any, messages: Any) -> None:
    for number in range(1000):
        bench.receive(f"host{number}/radar/tracks", messages.radar(bench.now_ns))
        bench.instances.add((f"host{number}", "radar", "x"))
        bench.receive(f"host{number}/radar/status", None)
        bench.pending.pop()
    bench.run(0.5)
    assert len(bench.pipeline.bad_input) <= 65
    assert sum(bench.pipeline.bad_input.values()) == 1000
    assert len(bench.health.services) <= 64 + len(SENSOR_TOPICS)
    assert len(bench.health.notes) <= 20
    assert bench.is_in("radar", "online")


def test_strangers_that_are_gone_make_room_for_those_that_are_there(new_bench: Any) -> None:
    """The status of 70 hosts that came and went; before, nobody who came later was heard any more."""
    bench = new_bench(FusionConfig(expects=("jetson0/gate",)))
    word = Report("x").snapshot()
    word.state = "online"
    for number in range(70):
        bench.instances.add((f"host{number:02}", "radar", "x"))
        bench.receive(f"host{number:02}/radar/status", word)
        bench.tick()
        bench.instances.discard((f"host{number:02}", "radar", "x"))
    for service in ("jetson0/gate", "pi9/radar"):
        bench.instances.add((*service.split("/"), "y"))
        word.stamp_ns = bench.now_ns
        bench.receive(f"{service}/status", word)
    bench.run(0.2)
    assert [bench.health.services[one].state for one in ("jetson0/gate", "pi9/radar")] == ["online", "online"]
    assert len(bench.health.services) <= 64 + len(SENSOR_TOPICS) + 1


def test_undecodable_payloads_are_named_when_they_leave_a_sensor_without_data(bench: Any) -> None:
    bench.silent.add("radar")
    for _ in range(20):
        bench.refused = {"pi0/radar/tracks": "RadarTracks: Expected `float`, got `str` - at `$.noise_floor_db`"}
        bench.tick()
    assert bench.is_in("radar", "disconnected")
    assert "Expected `float`" in bench.sensor("radar").reason
    assert bench.pipeline.bad_input["pi0/radar/tracks: undecodable"] == 20
    assert not bench.pipeline.take_new_bad_input(), "the decoder has counted them"


@pytest.mark.parametrize("field", ["noise_floor_db", "v_max_mps"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_no_nan_gets_past_the_codec(messages: Any, field: str, value: float) -> None:
    payload = encode(messages.radar(1, **{field: value}))
    with pytest.raises(DecodeError, match=field):
        decode(payload, RadarTracks)


def test_a_million_tracks_do_not_get_past_the_codec(messages: Any) -> None:
    message = messages.radar(1, "CAUTION")
    one = encode(message)
    message.tracks = message.tracks * 3000
    with pytest.raises(DecodeError, match="tracks"):
        decode(encode(message), RadarTracks)
    with pytest.raises(DecodeError, match="bytes, allowed"):
        decode(one + bytes(10**7), RadarTracks, max_bytes=10**6)


def test_extreme_stamps_do_not_crash(bench: Any, messages: Any) -> None:
    for stamp_ns in (0, 1, 2**63 - 1, 2**64 - 1, bench.now_ns + 10**12, bench.now_ns - 10**12):
        message = messages.radar(stamp_ns)
        message.seq = bench.seq["radar"] = bench.seq["radar"] + 1
        bench.silent.add("radar")
        bench.receive(bench.key("radar"), message)
        bench.tick()
        assert not bench.is_in("radar", "online")


def freeze_device(bench: Any, name: str, _: random.Random) -> None:
    bench.silent.add(name)
    bench.status(name, "disconnected", "no device")


def duplicate(bench: Any, name: str, _: random.Random) -> None:
    message = bench.message(name)
    for _ in range(3):
        bench.receive(bench.key(name), message)
    bench.delivered_s[name] = bench.now_s


def change_level(bench: Any, name: str, dice: random.Random) -> None:
    levels = ("SAFE", "CAUTION", "IMMINENT") if name != "camera" else (None, "SAFE", "CAUTION", "IMMINENT")
    bench.levels[name] = dice.choice(levels)


def isolate(bench: Any, _name: str, dice: random.Random) -> None:
    bench.isolated = dice.random() < 0.5


def heal(bench: Any, name: str, _: random.Random) -> None:
    bench.silent.discard(name)
    bench.extra[name], bench.delay_s[name], bench.clock_s[name], bench.isolated = {}, 0.02, 0.0, False
    bench.kill(name)
    bench.start(name, f"healed {bench.now_s}")


FAULTS: tuple[Callable[[Any, str, random.Random], Any], ...] = (
    lambda bench, name, _: bench.kill(name),
    lambda bench, name, _: bench.silent.add(name),
    lambda bench, name, dice: bench.delay_s.update({name: dice.choice((0.02, 0.3, 2.0))}),
    lambda bench, name, _: bench.extra.update({name: {"state": "degraded", "reason": "impaired by the test"}}),
    lambda bench, name, dice: bench.clock_s.update({name: dice.choice((0.0, 7.0, -7.0))}),
    lambda bench, name, _: bench.instances.add(("pi0" if name == "radar" else "jetson0", name, "rival")),
    lambda bench, name, _: bench.refused.update({bench.key(name): "not msgpack"}),
    *(freeze_device, duplicate, change_level, change_level, isolate, heal, heal),
)


@pytest.mark.parametrize("seed", range(200))
def test_random_fault_sequences(new_bench: Any, seed: int) -> None:
    """No SAFE while more than one is out, no IMMINENT lowered, never GO when blind; and all comes back in the end."""
    dice = random.Random(seed)
    bench = new_bench()
    bench.run(1.0)
    for _ in range(30):
        dice.choice(FAULTS)(bench, dice.choice(ONBOARD_SENSORS), dice)
        for _ in range(dice.randrange(1, 12)):
            check(bench, bench.tick())
    for name in ONBOARD_SENSORS:
        heal(bench, name, dice)
    bench.levels = {**dict.fromkeys(ONBOARD_SENSORS, "SAFE"), "camera": None}
    bench.until(lambda: bench.health.colour == "green" and bench.verdict.level == "SAFE", 4.0)


def check(bench: Any, verdict: Any) -> None:
    inputs = verdict.inputs
    for name in ONBOARD_SENSORS:  # what the bench knows of the sensors, whatever fusion believes
        if bench.is_dead(name):
            assert inputs[name].state != "online", (name, bench.sensor(name))
    out = sum(inputs[name].state != "online" for name in ONBOARD_SENSORS)
    if out >= 2:
        assert verdict.level != "SAFE"
    assert verdict.blind == (out == len(ONBOARD_SENSORS))
    if verdict.blind:
        assert verdict.permission == "STOP"
    for name in set(ONBOARD_SENSORS) - {"camera"}:
        if inputs[name].state != "disconnected" and inputs[name].level == "IMMINENT":
            assert verdict.level == "IMMINENT"
        if inputs[name].state != "disconnected" and RANK[inputs[name].level] >= 1 and not verdict.suppressed:
            assert verdict.level != "SAFE"
