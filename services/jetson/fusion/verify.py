"""Holds a recording against the rules: every verdict is decided again from what was recorded. Pure.

Three links are checked for each verdict: its inputs are what the recorded sensor messages said; the rules give the same
verdict from them; and what it remembered is what the next one began with.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import msgspec

from common.codec import DecodeError, decode, to_builtins
from common.messages import FusionTrace, Message, Verdict
from common.topics import SENSOR_TOPICS, find_topic
from services.jetson.fusion.evidence import FusionMemory, SensorInput
from services.jetson.fusion.readings import Reading, read
from services.jetson.fusion.trace import decide_again, inputs_of, memory_of

NOT_DECIDED = ("seq", "sent_ns", "received_ns")  # the publisher's fields, not the rules'
REMEMBERED_MESSAGES = 20_000
DELAY_MESSAGES = 1000  # topics arrive through queues of their own: a trace may overtake what it is about


@dataclass
class Report:
    """What was checked, and the first difference; ``difference`` empty = identical."""

    verdicts: int = 0
    decided_again: int = 0
    inputs_checked: int = 0
    difference: str = ""


@dataclass
class _Pending:
    verdicts: OrderedDict[int, Verdict] = field(default_factory=OrderedDict)
    readings: OrderedDict[tuple[str, int], Reading] = field(default_factory=OrderedDict)
    traces: deque[tuple[int, FusionTrace]] = field(default_factory=deque)  # with the count of messages before it
    after: tuple[int, FusionMemory] | None = None  # sequence number and memory after the last verdict decided again


def verify(recorded: Iterable[tuple[str, bytes]]) -> Report:
    """Check messages ``(key, payload)`` in order of arrival; stops at the first difference."""
    report, pending = Report(), _Pending()
    count = 0
    for count, (key, payload) in enumerate(recorded):
        topic = find_topic(key)
        if topic is None:
            continue
        try:
            message = decode(payload, topic.message, topic.max_bytes)
        except DecodeError as error:
            report.difference = f"{key}: {error}"
            return report
        _take(topic.name, message, count, report, pending)
        if _check_traces(count - DELAY_MESSAGES, report, pending):
            return report
    _check_traces(count, report, pending)
    return report


def _check_traces(until: int, report: Report, pending: _Pending) -> bool:
    """Check the traces that came up to this count; True when one does not hold."""
    while pending.traces and pending.traces[0][0] <= until:
        report.difference = _check(pending.traces.popleft()[1], report, pending)
        if report.difference:
            return True
    return False


def _take(name: str, message: Message, count: int, report: Report, pending: _Pending) -> None:
    sensor = next((sensor for sensor, topic in SENSOR_TOPICS.items() if topic.name == name), None)
    if sensor is not None:
        _keep(pending.readings, (sensor, message.stamp_ns), read(message))
    elif isinstance(message, Verdict):
        report.verdicts += 1
        _keep(pending.verdicts, message.seq, message)
    elif isinstance(message, FusionTrace):
        pending.traces.append((count, message))


def _check(trace: FusionTrace, report: Report, pending: _Pending) -> str:
    """The first link that does not hold, in words; empty when all do."""
    try:
        verdict, after = decide_again(trace)
        memory = memory_of(trace)
        sensors = {**inputs_of(trace).sensors, "infra_lidar": inputs_of(trace).roadside}
    except msgspec.ValidationError as error:
        return f"verdict {trace.verdict_seq}: its trace cannot be read: {error}"
    if pending.after is not None and pending.after[0] + 1 == trace.verdict_seq and pending.after[1] != memory:
        return f"verdict {trace.verdict_seq}: began with {memory}, the one before left {pending.after[1]}"
    pending.after = (trace.verdict_seq, after)
    for name, sensor in sensors.items():
        difference = _check_input(name, sensor, report, pending)
        if difference:
            return f"verdict {trace.verdict_seq}: {difference}"
    recorded = pending.verdicts.get(trace.verdict_seq)
    if recorded is None:
        return ""  # the recording began between the verdict and its trace
    report.decided_again += 1
    return _difference(recorded, verdict)


def _check_input(name: str, sensor: SensorInput | None, report: Report, pending: _Pending) -> str:
    """The roadside's level is fusion's own; of the others it has to be what their message said."""
    if sensor is None or name == "infra_lidar" or sensor.state == "disconnected":
        return ""
    reading = pending.readings.get((name, sensor.stamp_ns))
    if reading is None:
        return ""  # it came before the recording began
    report.inputs_checked += 1
    raw_level = reading.raw_level if sensor.raw_level is not None else None  # traces of before it was used have none
    said = (reading.level, reading.static_level, reading.nearest_m, reading.sightings, raw_level)
    used = (sensor.level, sensor.static_level, sensor.nearest_m, sensor.sightings, sensor.raw_level)
    if said == used:
        return ""
    return f"{name} said (level, static level, nearest m, objects, raw level) {said}, fusion used {used}"


def _difference(recorded: Verdict, again: Verdict) -> str:
    old, new = to_builtins(recorded), to_builtins(again)
    for name in old:
        if name not in NOT_DECIDED and old[name] != new[name]:
            return f"verdict {recorded.seq}: {name} was {old[name]!r}, the rules now give {new[name]!r}"
    return ""


def _keep(table: OrderedDict, key: object, value: object) -> None:
    table[key] = value
    while len(table) > REMEMBERED_MESSAGES:
        table.popitem(last=False)
