"""The state of one sensor, from its token, the age of its data, its own word, and the trust in its clock.

Absence is an input: the question is never "did it report a fault" but "has it shown lately that it can see". The first
broken link is named (``cause``), so that a dead Pi is not a radar fault.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, cast

from common.bus.pubsub import Received
from common.clock import WRONG_CLOCK_S, clock_words
from common.messages import LinkFault, Message, SensorHealth, SensorState, ServiceStatus, SourceKind
from common.topics import Topic, spoken, status_topic
from services.jetson.fusion.config import HealthConfig
from services.jetson.fusion.dating import SAME_CLOCK, Age, SenderClock, age_of
from services.jetson.fusion.evidence import SensorInput
from services.jetson.fusion.ordering import Ordering
from services.jetson.fusion.readings import Reading, read
from services.jetson.fusion.recovery import Recovery

SILENT_S = 1.5  # a process that works sends its status every second, whatever the sensor does
STATUS_AGE_LIMIT_S = cast(float, status_topic("any").age_limit_s)


@dataclass(frozen=True, slots=True)
class LinkState:
    """What is known about a sensor's service from outside its data."""

    instances: tuple[str, ...] = ()  # of this service on its host, from the tokens
    handing_over: bool = False  # one of them announced that it takes over, and the old one still speaks
    host_alive: bool = True  # any token of that host
    isolated: bool = False  # we have lost our own link
    status: DatedStatus | None = None
    clock_distrust: str = ""
    clock: SenderClock = SAME_CLOCK
    unlinked: LinkFault | None = None  # why our router cannot link its host
    undecodable: str = ""  # why the last message was refused


class Fault(NamedTuple):
    """What is wrong with a sensor: its state, the first broken link, and a sentence."""

    state: SensorState
    cause: str
    reason: str


class DatedStatus(NamedTuple):
    """What a service said of itself, and how old that was when it came."""

    received: Received[ServiceStatus]
    age: Age

    @property
    def message(self) -> ServiceStatus:
        """What the service said."""
        return self.received.message

    def is_fresh(self, now_s: float) -> bool:
        """Younger than the topic's limit by its stamp; a repeated one is as old as it says."""
        return self.age.now(now_s) <= STATUS_AGE_LIMIT_S


class Frame(NamedTuple):
    """The newest accepted message and how old its measurement was when it came."""

    received: Received[Message]
    reading: Reading
    age: Age


class SensorWatch:
    """Follows one sensor. ``take`` every message, then ``judge`` as often as needed."""

    def __init__(self, name: str, host: str, topic: Topic, config: HealthConfig) -> None:
        assert topic.age_limit_s is not None
        self.name, self.host, self.service = name, host, topic.service
        self.limit_s: float = topic.age_limit_s
        self.frame: Frame | None = None
        self._config = config
        self._ordering = Ordering(self.limit_s)
        self._arrivals_s: deque[float] = deque()
        self.recovery = Recovery(config)
        self.state: SensorState = "disconnected"
        self._since_ns = 0
        self._silent_s_before_token: float | None = None
        self._was_there = False

    @property
    def reported(self) -> bool:
        """It has delivered at least one message since we started."""
        return self.frame is not None

    @property
    def source_kind(self) -> SourceKind:
        """Of the newest message."""
        return "unknown" if self.frame is None else self.frame.received.message.source_kind

    def take(self, received: Received[Message], link: LinkState) -> str:
        """Accept a message; or say why not: a repetition, or older than what we have."""
        refused = self._ordering.check(received, " ".join(link.instances), announced=link.handing_over)
        if refused:
            return refused
        self.frame = Frame(received, read(received.message), age_of(received, link.clock))
        self._arrivals_s.append(received.arrived_s)
        while self._arrivals_s and received.arrived_s - self._arrivals_s[0] > self._config.rate_window_s:
            self._arrivals_s.popleft()
        fault = self._data_fault(received.arrived_s, link)
        self.recovery.note_frame(received.arrived_s, fault.state if fault else "online")
        return ""

    def judge(self, now_s: float, now_ns: int, link: LinkState) -> tuple[SensorInput, SensorHealth]:
        """The sensor's state now, for the verdict and for people."""
        fault = self._link_fault(now_s, link) or self._data_fault(now_s, link)
        if fault is not None:
            self.recovery.note_fault(now_s, fault.state, reported=self.reported)
        fault = self._recovering(now_s, fault) or fault
        state: SensorState = fault.state if fault else "online"
        if state != self.state or self._since_ns == 0:
            self.state, self._since_ns = state, now_ns
        self.recovery.judged(state)
        return self._input(now_s, state, fault), self._health(now_s, state, fault)

    def age_s(self, now_s: float) -> float | None:
        """Of the newest frame; None when there is none."""
        return None if self.frame is None else self.frame.age.now(now_s)

    def _link_fault(self, now_s: float, link: LinkState) -> Fault | None:
        """The links before the data, first broken one first: our own, the host, the process, the device."""
        if link.isolated:
            return Fault("disconnected", "isolated", "fusion has lost its own link to the network")
        if not link.instances:
            return self._gone(now_s, link)
        self._was_there, self._silent_s_before_token = True, None
        status = self._status(now_s, link)
        if status is not None and status.message.state == "disconnected":
            newer = self.frame is None or status.age.arrived_s >= self.frame.age.arrived_s
            if newer:
                return Fault("disconnected", "device_lost", status.message.reason or "the device is lost")
        return None

    def _gone(self, now_s: float, link: LinkState) -> Fault:
        """No token. A process that ends takes it along at once; one that is frozen or cut off is silent before."""
        if link.unlinked is not None and not link.host_alive:
            return Fault("disconnected", link.unlinked.cause, link.unlinked.why)
        if not self._was_there and self.frame is None:
            return Fault("disconnected", "waiting", f"waiting for {self.host}/{self.service}: never seen")
        if self._silent_s_before_token is None:
            self._silent_s_before_token = self._silent_s(now_s, link)
        silent_first = self._silent_s_before_token > SILENT_S
        who = f"{spoken(self.name)} on {self.host}"
        if link.host_alive and silent_first:
            return Fault("disconnected", "not_answering", f"{who} does not answer: its process hangs; the host is up")
        if link.host_alive:
            return Fault("disconnected", "service_gone", f"{who} has ended; the host is up")
        if silent_first:
            text = f"{who} does not answer: network cut, host down, or its process hangs"
            return Fault("disconnected", "host_unreachable", text)
        return Fault("disconnected", "service_gone", f"{who} has ended")

    def _silent_s(self, now_s: float, link: LinkState) -> float:
        """Since the last message of any kind from its process; 0.0 when there never was one."""
        heard_s = [self.frame.age.arrived_s] if self.frame else []
        heard_s += [link.status.age.arrived_s] if link.status else []
        return now_s - max(heard_s, default=now_s)

    def _data_fault(self, now_s: float, link: LinkState) -> Fault | None:
        """What is wrong with the data: missing, old, undatable, contested, or the sensor cannot see."""
        if self.frame is None:
            status = self._status(now_s, link)
            detail = f" ({status.message.reason})" if status and status.message.reason else ""
            text = link.undecodable or f"{spoken(self.name)} on {self.host} is there, no data yet{detail}"
            return Fault("disconnected", "waiting", text)
        age = self.frame.age
        too_old = age.at_most(now_s) > self.limit_s
        if abs(age.at_arrival_s) > WRONG_CLOCK_S:
            state: SensorState = "disconnected" if too_old else "degraded"
            return Fault(state, "clock", clock_words(self.host, -age.at_arrival_s))
        if too_old:
            return self._stale(now_s, age, link)
        if age.at_arrival_s < -self._config.future_s:
            return Fault("degraded", "clock", f"data stamped {-age.at_arrival_s:.1f} s in the future")
        if link.clock_distrust:
            return Fault("degraded", "clock", f"{self.host}/{self.service}: {link.clock_distrust}")
        if len(link.instances) > 1:
            text = f"{len(link.instances)} processes claim {self.host}/{self.service}"
            return Fault("degraded", "two_claimants", text)
        if self._ordering.two_senders(now_s):
            text = f"sequence numbers go back and forth: does somebody else send as {self.host}/{self.service}?"
            return Fault("degraded", "two_claimants", text)
        if self.frame.reading.state == "degraded":
            return Fault("degraded", "impaired", self.frame.reading.reason or "degraded, no reason given")
        status = self._status(now_s, link)
        if status is not None and status.message.state == "degraded":
            return Fault("degraded", "impaired", status.message.reason or "degraded, no reason given")
        return None

    def _stale(self, now_s: float, age: Age, link: LinkState) -> Fault:
        heard_s = self._silent_s(now_s, link)
        if heard_s > SILENT_S and not link.undecodable:
            text = f"{spoken(self.name)} on {self.host} does not answer: nothing was heard for {heard_s:.1f} s"
            return Fault("disconnected", "not_answering", text)
        return Fault("disconnected", "stale", self._stale_reason(now_s, age, link))

    def _stale_reason(self, now_s: float, age: Age, link: LinkState) -> str:
        if link.undecodable:
            return link.undecodable
        age_s, silent_s = age.now(now_s), now_s - age.arrived_s
        if silent_s > self.limit_s:
            return f"stale: no data for {silent_s:.1f} s (limit {self.limit_s:.1f} s), the process is there"
        if age_s <= self.limit_s:
            known = f"its clock is known to {age.bound_s * 1e3:.0f} ms only"
            return f"stale: data may be {age.at_most(now_s):.2f} s old (limit {self.limit_s:.1f} s), {known}"
        if silent_s > age.at_arrival_s:
            return f"stale: the last data is {age_s:.2f} s old (limit {self.limit_s:.1f} s), the process is there"
        return f"stale: data comes late, it is {age_s:.1f} s old (limit {self.limit_s:.1f} s)"

    def _recovering(self, now_s: float, fault: Fault | None) -> Fault | None:
        """Nothing gets better before enough good frames in a row; until then the state stays what it was."""
        lacks = self.recovery.lacks(now_s, self.state, fault.state if fault else "online")
        if not lacks:
            return None
        return Fault(self.state, "recovering", f"{lacks}; {fault.reason}" if fault else lacks)

    def _status(self, now_s: float, link: LinkState) -> DatedStatus | None:
        return link.status if link.status is not None and link.status.is_fresh(now_s) else None

    def _input(self, now_s: float, state: SensorState, fault: Fault | None) -> SensorInput:
        reason, age_s = fault.reason if fault else "", self.age_s(now_s)
        if self.frame is None or state == "disconnected":
            return SensorInput(state=state, level=None, age_s=age_s, reason=reason, source_kind=self.source_kind)
        reading = self.frame.reading
        return SensorInput(
            state=state,
            level=reading.level,
            age_s=age_s,
            static_level=reading.static_level,
            nearest_m=reading.nearest_m,
            reason=reason,
            stamp_ns=self.frame.received.message.stamp_ns,
            stage_ms=stages(self.frame, now_s),
            deciding=reading.deciding,
            source_kind=self.source_kind,
            sightings=reading.sightings,
            raw_level=reading.raw_level,
        )

    def _health(self, now_s: float, state: SensorState, fault: Fault | None) -> SensorHealth:
        age_s = self.age_s(now_s)
        recent_s = [at_s for at_s in self._arrivals_s if now_s - at_s <= self._config.rate_window_s]
        return SensorHealth(
            state=state,
            reason=fault.reason if fault else "",
            since_ns=self._since_ns,
            age_ms=None if age_s is None else round(age_s * 1e3, 1),
            rate_hz=rate_hz(recent_s),
            cause=fault.cause if fault else "",
            source_kind=self.source_kind,
        )


def rate_hz(arrivals_s: list[float]) -> float:
    """Messages a second between the first and the last arrival; a burst counts as a millisecond."""
    if len(arrivals_s) < 2:
        return 0.0
    return (len(arrivals_s) - 1) / max(arrivals_s[-1] - arrivals_s[0], 1e-3)


def stages(frame: Frame, now_s: float) -> dict[str, float]:
    """Where the age of a frame comes from, in milliseconds; only what its stamps can tell."""
    received, message = frame.received, frame.received.message
    split = {"fusion": (now_s - received.arrived_s) * 1e3}
    offset_ns = frame.age.at_arrival_s * 1e9 - (received.arrived_ns - message.stamp_ns)
    if message.received_ns:
        split["capture"] = (message.received_ns - message.stamp_ns) * 1e-6
    if message.sent_ns:
        split["processing"] = (message.sent_ns - (message.received_ns or message.stamp_ns)) * 1e-6
        split["transport"] = (received.arrived_ns - message.sent_ns + offset_ns) * 1e-6
    return {name: round(value_ms, 3) for name, value_ms in split.items()}
