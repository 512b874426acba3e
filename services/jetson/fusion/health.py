"""The state of one sensor, from its token, the age of its data, its own word, and the trust in its clock.

Absence is an input: the question is never "did it report a fault" but "has it shown lately that it can see". The first
broken link is named (``cause``), so that a dead Pi is not a radar fault.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, cast

from common.messages import Message, SensorHealth, SensorState, ServiceStatus
from common.pubsub import Received
from common.topics import Topic, status_topic
from services.jetson.fusion.config import HealthConfig
from services.jetson.fusion.evidence import SensorInput
from services.jetson.fusion.ordering import Ordering
from services.jetson.fusion.readings import Reading, read

STATUS_AGE_LIMIT_S = cast(float, status_topic("any").age_limit_s)

RANK_OF_STATE: dict[SensorState, int] = {"online": 0, "degraded": 1, "disconnected": 2}


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is known about a sensor's service from outside its data."""

    instances: tuple[str, ...] = ()  # of this service on its host, from the tokens
    handing_over: bool = False  # one of them announced that it takes over, and the old one still speaks
    host_alive: bool = True  # any token of that host
    isolated: bool = False  # we have lost our own link
    status: Received[ServiceStatus] | None = None
    clock_distrust: str = ""
    clock_offset_s: float | None = 0.0  # their clock minus ours; None = their stamps cannot be dated now
    undecodable: str = ""  # what was wrong with the last payload that was refused


class Fault(NamedTuple):
    """What is wrong with a sensor: its state, the first broken link, and a sentence."""

    state: SensorState
    cause: str
    reason: str


class Frame(NamedTuple):
    """The newest accepted message and how old its measurement was when it came."""

    received: Received[Message]
    reading: Reading
    stamp_age_s: float  # at arrival, by their stamp and the clock offset; negative = from the future


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
        self._fresh_frames = 0  # in a row that came in time
        self._good_frames = 0  # in a row without any fault
        self._state: SensorState = "disconnected"
        self._since_ns = 0
        self._data_ended_s_before_token: float | None = None
        self._was_there = False

    @property
    def reported(self) -> bool:
        """It has delivered at least one message since we started."""
        return self.frame is not None

    def take(self, received: Received[Message], around: Surroundings) -> str:
        """Accept a message; or say why not: a repetition, or older than what we have."""
        message = received.message
        stamp_age_s = 0.0
        if around.clock_offset_s is not None:
            stamp_age_s = (received.arrived_ns - message.stamp_ns) * 1e-9 + around.clock_offset_s
        refused = self._ordering.check(received, " ".join(around.instances), announced=around.handing_over)
        if refused:
            return refused
        self.frame = Frame(received, read(message), stamp_age_s)
        self._arrivals_s.append(received.arrived_s)
        while self._arrivals_s and received.arrived_s - self._arrivals_s[0] > self._config.rate_window_s:
            self._arrivals_s.popleft()
        fault = self._data_fault(received.arrived_s, around)
        self._good_frames = 0 if fault else self._good_frames + 1
        self._fresh_frames = 0 if fault and fault.state == "disconnected" else self._fresh_frames + 1
        return ""

    def judge(self, now_s: float, now_ns: int, around: Surroundings) -> tuple[SensorInput, SensorHealth]:
        """The sensor's state now, for the verdict and for people."""
        fault = self._link_fault(now_s, around) or self._data_fault(now_s, around)
        if fault is not None:
            self._good_frames = 0
            self._fresh_frames = 0 if fault.state == "disconnected" else self._fresh_frames
        fault = self._recovering(fault) or fault
        state: SensorState = fault.state if fault else "online"
        if state != self._state or self._since_ns == 0:
            self._state, self._since_ns = state, now_ns
        return self._input(now_s, state, fault), self._health(now_s, state, fault)

    def age_s(self, now_s: float) -> float | None:
        """Of the newest frame; None when there is none."""
        return None if self.frame is None else age_s_of(self.frame, now_s)

    def _link_fault(self, now_s: float, around: Surroundings) -> Fault | None:
        """The links before the data, first broken one first: our own, the host, the process, the device."""
        if around.isolated:
            return Fault("disconnected", "isolated", "fusion has lost its own link to the network")
        if not around.instances:
            return self._gone(now_s, around)
        self._was_there, self._data_ended_s_before_token = True, None
        status = self._status(now_s, around)
        if status is not None and status.message.state == "disconnected":
            newer = self.frame is None or status.arrived_s >= self.frame.received.arrived_s
            if newer:
                return Fault("disconnected", "device_lost", status.message.reason or "the device is lost")
        return None

    def _gone(self, now_s: float, around: Surroundings) -> Fault:
        """No token. Silence before the token went means the link or the host; else the process ended."""
        if not self._was_there and self.frame is None:
            return Fault("disconnected", "waiting", f"waiting for {self.host}/{self.service}: never seen")
        if self._data_ended_s_before_token is None:
            silent_s = now_s - self.frame.received.arrived_s if self.frame else 0.0
            self._data_ended_s_before_token = silent_s
        if around.host_alive:
            return Fault("disconnected", "service_gone", f"{self.service} on {self.host} has ended; the host is up")
        if self._data_ended_s_before_token > self.limit_s:
            return Fault("disconnected", "host_unreachable", f"{self.host} is unreachable: network cut or host down")
        return Fault("disconnected", "service_gone", f"{self.service} on {self.host} has ended")

    def _data_fault(self, now_s: float, around: Surroundings) -> Fault | None:
        """What is wrong with the data: missing, old, undatable, contested, or the sensor cannot see."""
        if self.frame is None:
            status = self._status(now_s, around)
            told = f" ({status.message.reason})" if status and status.message.reason else ""
            text = around.undecodable or f"{self.service} on {self.host} is there, no data yet{told}"
            return Fault("disconnected", "waiting", text)
        age_s = age_s_of(self.frame, now_s)
        if age_s > self.limit_s:
            return Fault("disconnected", "stale", self._stale_reason(now_s, age_s, around))
        if self.frame.stamp_age_s < -self._config.future_s:
            return Fault("degraded", "clock", f"data stamped {-self.frame.stamp_age_s:.1f} s in the future")
        if around.clock_distrust:
            return Fault("degraded", "clock", f"{self.host}/{self.service}: {around.clock_distrust}")
        if len(around.instances) > 1:
            text = f"{len(around.instances)} processes claim {self.host}/{self.service}"
            return Fault("degraded", "two_claimants", text)
        if self._ordering.two_senders(now_s):
            text = f"sequence numbers go back and forth: does somebody else send as {self.host}/{self.service}?"
            return Fault("degraded", "two_claimants", text)
        if self.frame.reading.state == "degraded":
            return Fault("degraded", "impaired", self.frame.reading.reason or "degraded, no reason given")
        status = self._status(now_s, around)
        if status is not None and status.message.state == "degraded":
            return Fault("degraded", "impaired", status.message.reason or "degraded, no reason given")
        return None

    def _stale_reason(self, now_s: float, age_s: float, around: Surroundings) -> str:
        assert self.frame is not None
        if around.undecodable:
            return around.undecodable
        silent_s = now_s - self.frame.received.arrived_s
        if silent_s > self.frame.stamp_age_s:
            return f"stale: no data for {silent_s:.1f} s (limit {self.limit_s:.1f} s), the process is there"
        return f"stale: data comes late, it is {age_s:.1f} s old (limit {self.limit_s:.1f} s)"

    def _recovering(self, fault: Fault | None) -> Fault | None:
        """Nothing gets better before enough good frames in a row; until then the state stays what it was."""
        better = RANK_OF_STATE[fault.state if fault else "online"] < RANK_OF_STATE[self._state]
        frames = self._good_frames if fault is None else self._fresh_frames
        if not better or frames >= self._config.recovery_frames:
            return None
        text = f"recovering, {frames} of {self._config.recovery_frames} good frames"
        return Fault(self._state, "recovering", f"{text}; {fault.reason}" if fault else text)

    def _status(self, now_s: float, around: Surroundings) -> Received[ServiceStatus] | None:
        status = around.status
        return status if status is not None and now_s - status.arrived_s <= STATUS_AGE_LIMIT_S else None

    def _input(self, now_s: float, state: SensorState, fault: Fault | None) -> SensorInput:
        reason, age_s = fault.reason if fault else "", self.age_s(now_s)
        if self.frame is None or state == "disconnected":
            return SensorInput(state=state, level=None, age_s=age_s, reason=reason)
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
        )


def age_s_of(frame: Frame, now_s: float) -> float:
    """Since the measurement: time since arrival on our monotonic clock plus its age when it arrived."""
    return max(0.0, now_s - frame.received.arrived_s) + max(0.0, frame.stamp_age_s)


def rate_hz(arrivals_s: list[float]) -> float:
    """Messages a second between the first and the last arrival; a burst counts as a millisecond."""
    if len(arrivals_s) < 2:
        return 0.0
    return (len(arrivals_s) - 1) / max(arrivals_s[-1] - arrivals_s[0], 1e-3)


def stages(frame: Frame, now_s: float) -> dict[str, float]:
    """Where the age of a frame comes from, in milliseconds; only what its stamps can tell."""
    received, message = frame.received, frame.received.message
    split = {"fusion": (now_s - received.arrived_s) * 1e3}
    offset_ns = frame.stamp_age_s * 1e9 - (received.arrived_ns - message.stamp_ns)
    if message.received_ns:
        split["capture"] = (message.received_ns - message.stamp_ns) * 1e-6
    if message.sent_ns:
        split["processing"] = (message.sent_ns - (message.received_ns or message.stamp_ns)) * 1e-6
        split["transport"] = (received.arrived_ns - message.sent_ns + offset_ns) * 1e-6
    return {name: round(value_ms, 3) for name, value_ms in split.items()}
