"""One random world, from its seed to its outcome, in simulated time."""

from __future__ import annotations

import random
import traceback
from typing import Any

import msgspec

from common.bus.pubsub import Received
from common.messages import EgoMotion, SensorMessage, ServiceStatus, Verdict
from common.topics import EGO_MOTION, SENSOR_TOPICS
from services.jetson.fusion.clocks import ClockSample
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.store import Saved
from spotter_tools.random_worlds.bodies import Body, Vehicle, in_reach, level_at, message_of, scatter
from spotter_tools.random_worlds.faults import SENSORS, Faults, Line
from spotter_tools.random_worlds.judge import Judge, Outcome

TICK_S = 0.05
START_S, START_NS = 1000.0, 1_800_000_000_000_000_000
FAULT_EVERY_S = (2.5, 8.0, 25.0)  # on the average; each world has one of these
MISSED = 0.3  # share of a body's pictures in which the detector misses it


class World:
    """Bodies, vehicle, sensors, faults, and fusion's pipeline that gets their messages."""

    def __init__(self, seed: int, seconds: float, config: FusionConfig) -> None:
        self.dice = random.Random(seed)
        self.config = msgspec.structs.replace(config, sensors=config.sensors.only(SENSORS))
        self.pipeline = FusionPipeline(self.config)
        self.bodies, self.vehicle = scatter(self.dice, seconds), Vehicle()
        self.faults = Faults(self.dice)
        self.fault_every_s = self.dice.choice(FAULT_EVERY_S)
        self.judge = Judge(Outcome(seed), config.rules)
        self.drives = self.dice.random() < 0.6
        self.now_s, self.seconds = 0.0, seconds
        self.steady_since_s = 0.0
        self.on_the_way: list[tuple[float, str, SensorMessage]] = []
        self.seq = dict.fromkeys(SENSORS, 0)
        self.alarming: dict[str, dict[int, set[int]]] = {name: {} for name in SENSORS}
        self.seen = Observation(now_s=START_S, now_ns=START_NS)
        self._there: tuple[bool, ...] = ()
        self._ego = (0.0, 0.0)

    def step(self) -> Verdict:
        """One step of 50 ms."""
        self.now_s += TICK_S
        dice, faults = self.dice, self.faults
        if dice.random() < TICK_S / self.fault_every_s and faults.strike(self.now_s):
            self.restart_fusion()
        if dice.random() < TICK_S / 20.0:
            faults.calm(self.now_s)
        if self.drives and dice.random() < TICK_S / 8.0:
            self.vehicle.speed_mps = dice.choice((0.0, 0.0, 0.0, 0.3, 1.0, -0.5))
            self.vehicle.yaw_rate_radps = dice.choice((0.0, 0.0, 0.4, -0.4)) if self.vehicle.speed_mps else 0.0
            faults.changed_s = self.now_s
        self.vehicle.step(TICK_S)
        self.measure()
        verdict, _ = self.pipeline.process(self.observe())
        self.judge_it(verdict)
        return verdict

    def restart_fusion(self) -> None:
        """The process is killed; what was on disk a moment before is what the next one knows."""
        saved = msgspec.json.decode(msgspec.json.encode(self.pipeline.state(self.seen)), type=Saved)
        self.pipeline = FusionPipeline(self.config, saved)
        self.judge.used_ns.clear()

    def measure(self) -> None:
        """Ten times a second every living sensor sends what it sees."""
        if round(self.now_s / TICK_S) % 2:
            return
        for name, line in self.faults.lines.items():
            if not line.alive or line.silent or self.dice.random() < line.loss:
                continue
            seen, shown = self.look(name, line)
            stamp_ns = self.utc_ns() + round((line.clock_s - 0.01) * 1e9)
            bad = "covered" if line.covered else "impaired" if self.dice.random() < line.bad else ""
            message = message_of(name, stamp_ns, seen, bad)
            message.seq, self.seq[name] = self.seq[name], self.seq[name] + 1
            message.received_ns = message.sent_ns = stamp_ns
            self.alarming[name][stamp_ns] = shown
            self.on_the_way.append((self.now_s + line.delay_s, name, message))

    def look(self, name: str, line: Line) -> tuple[list[tuple[float, float]], set[int]]:
        """Positions of the bodies in the message, and which of them it shows at alarm level."""
        seen, shown = [], set()
        for body in self.bodies:
            at = None if name not in body.seen_by or line.covered else self.place(body)
            if at is None or not in_reach(name, *at) or (name == "camera" and self.dice.random() < MISSED):
                continue
            seen.append(at)
            if level_at(name, at[0]) != "SAFE":
                shown.add(body.number)
        return seen, shown

    def place(self, body: Body) -> tuple[float, float] | None:
        """Where a body is from the vehicle, (x, y) in m; None while it is not there."""
        at = body.place(self.now_s)
        return None if at is None else self.vehicle.sees_at(at)

    def utc_ns(self) -> int:
        """True UTC."""
        return START_NS + round(self.now_s * 1e9)

    def observe(self) -> Observation:
        """What fusion sees of all this."""
        faults, now_s = self.faults, START_S + self.now_s
        now_ns = self.utc_ns() + round(faults.own_clock_s * 1e9)
        arrived = [one for one in self.on_the_way if one[0] <= self.now_s]
        self.on_the_way = [one for one in self.on_the_way if one[0] > self.now_s]
        received: list[Received[Any]] = [
            Received(SENSOR_TOPICS[name].key(self.host(name)), message, now_s, now_ns)
            for _, name, message in ([] if faults.isolated else arrived)
        ]
        received += [] if faults.isolated else [*self.motion(now_s, now_ns), *self.statuses(now_s, now_ns)]
        living = {name: line for name, line in faults.lines.items() if line.alive}
        samples: tuple[ClockSample, ...] = ()
        if round(self.now_s / TICK_S) % 10 == 0 and not faults.isolated:
            samples = tuple(
                ClockSample(f"{self.host(name)}/{name}", now_s, line.clock_s - faults.own_clock_s, 0.001)
                for name, line in living.items()
            )
        present = frozenset((self.host(name), name, str(line.instance)) for name, line in living.items())
        self.seen = Observation(now_s, now_ns, tuple(received), present, faults.isolated, samples)
        return self.seen

    def host(self, name: str) -> str:
        """The host of a sensor."""
        host: str = getattr(self.config.sensors, name).host
        return host

    def motion(self, now_s: float, now_ns: int) -> list[Received[Any]]:
        """What the ego service says: nothing, the truth, the reverse, something wrong, or always the same."""
        kind, car = self.faults.ego, self.vehicle
        if kind == "none":
            return []
        if kind != "stuck":
            factor = {"true": 1.0, "reversed": -1.0}.get(kind, self.faults.ego_scale)
            self._ego = (car.speed_mps * factor, car.yaw_rate_radps * factor)
        speed_mps, yaw_rate_radps = self._ego[0], self._ego[1] if kind != "stuck" else 0.0
        message = EgoMotion(stamp_ns=now_ns, speed_mps=speed_mps, yaw_rate_radps=yaw_rate_radps)
        return [Received(EGO_MOTION.key(self.config.ego_host), message, now_s, now_ns)]

    def statuses(self, now_s: float, now_ns: int) -> list[Received[Any]]:
        """A service whose device is gone says so."""
        lost = [name for name, line in self.faults.lines.items() if line.unplugged and line.alive]
        return [Received(f"{self.host(name)}/{name}/status", _device_lost(now_ns), now_s, now_ns) for name in lost]

    def judge_it(self, verdict: Verdict) -> None:
        """Hold the verdict against the truth."""
        seen_by = {body.number: body.seen_by for body in self.bodies}
        for name in SENSORS:
            self.judge.note_used(name, verdict, self.alarming[name], seen_by)
        ahead = {body.number: at for body in self.bodies if (at := self.place(body)) is not None}
        for number, (x_m, _) in ahead.items():
            if x_m < -1.0:
                self.judge.left_behind(number)
        there = tuple(body.place(self.now_s) is not None for body in self.bodies)
        moving = bool(self.vehicle.speed_mps) or any(body.walk_m for body in self.bodies)
        if there != self._there or moving:
            self._there, self.steady_since_s = there, self.now_s
        self.judge.verdict(self.now_s, verdict, ahead, self.vehicle.speed_mps)
        self.judge.changes(self.now_s, verdict, max(self.steady_since_s, self.faults.changed_s))


def run(seed: int, seconds: float = 60.0, config: FusionConfig | None = None) -> Outcome:
    """The outcome of one world; an exception is counted and reported, not raised."""
    world = World(seed, seconds, config or FusionConfig())
    try:
        while world.now_s < seconds:
            world.step()
    except Exception:  # noqa: BLE001  # whatever it is, it is the finding
        world.judge.outcome.errors += 1
        world.judge.outcome.first = world.judge.outcome.first or traceback.format_exc()
    return world.judge.outcome


def _device_lost(now_ns: int) -> ServiceStatus:
    return ServiceStatus(
        stamp_ns=now_ns, state="disconnected", reason="no device", published=0, dropped=0, bad_input=0, rate_hz=0.0,
        last_frame_age_s=None, stage_ms={}, rss_mb=1.0,
    )  # fmt: skip
