"""Observations in, verdict and health out. No network, no clock: the time is part of the observation."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

from common.messages import ObjectTracks, SensorHealth, SystemHealth, Verdict
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.evidence import FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.inbox import ONBOARD, Inbox
from services.jetson.fusion.latency import LatencyBook
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.reporter import Reporter
from services.jetson.fusion.roadside import RoadsideAlarm, find_threat, tabulate
from services.jetson.fusion.vehicle import Vehicle, vehicle_now
from services.jetson.fusion.verdict import fuse


class Step(NamedTuple):
    """The inputs of one verdict and the memory before it: enough to decide it again."""

    inputs: FusionInputs
    memory: FusionMemory


Judged = dict[str, tuple[SensorInput, SensorHealth]]


class FusionPipeline:
    """``process`` every observation: on every input and at least at the verdict's period."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._inbox = Inbox(config)
        self._memory = FusionMemory()
        self.step: Step | None = None  # what the last verdict was decided from
        self._alarm = RoadsideAlarm(config.roadside)
        self._tracks_stamp_ns = 0  # of the roadside message that was looked at last
        self.latency = LatencyBook({name: getattr(config.sensors, name).budget_ms for name in self._inbox.watches})
        self._reporter = Reporter(config, self._inbox, self.latency)

    @property
    def bad_input(self) -> Counter[str]:
        """What was refused since the start, by key and reason."""
        return self._inbox.bad_input

    def take_new_bad_input(self) -> Counter[str]:
        """What this pipeline refused since the last call; undecodable payloads are counted by who decodes."""
        taken, self._inbox.new_bad_input = self._inbox.new_bad_input, Counter()
        return taken

    def process(self, seen: Observation) -> tuple[Verdict, SystemHealth | None]:
        """The verdict now; and health when it has changed or is due."""
        # 1. what arrived goes to the sensor it is about
        around = self._inbox.sort(seen)
        # 2. the state of every sensor: link, process, device, data, clock
        judged: Judged = {
            name: watch.judge(seen.now_s, seen.now_ns, around[name]) for name, watch in self._inbox.watches.items()
        }
        # 3. what the roadside means for the vehicle
        vehicle = vehicle_now(self._inbox.ego, seen.now_s, self._config)
        roadside = self._from_roadside(judged["infra_lidar"][0], vehicle)
        # 4. the verdict, by the rules
        inputs = self._inputs(seen, judged, vehicle, roadside)
        self.step = Step(inputs, self._memory)
        verdict, self._memory = fuse(inputs, self._memory, self._config.rules)
        # 5. how old was all that
        self.latency.add({name: sensor for name, (sensor, _) in judged.items()})
        # 6. health for people, when there is news
        return verdict, self._reporter.report(seen, {name: told for name, (_, told) in judged.items()})

    def _from_roadside(self, sensor: SensorInput, vehicle: Vehicle) -> SensorInput | None:
        """The roadside lidar as a witness; None when it is switched off."""
        if not self._config.roadside.enabled:
            return None
        frame = self._inbox.watches["infra_lidar"].frame
        if sensor.state == "disconnected" or frame is None or sensor.age_s is None:
            self._alarm.reset()
            return replace(sensor, level=None)
        if vehicle.T_map_vehicle is None:
            self._alarm.reset()
            return replace(sensor, state="disconnected", level=None, reason="the vehicle's pose is unknown")
        message = frame.received.message
        if isinstance(message, ObjectTracks) and message.stamp_ns != self._tracks_stamp_ns:
            self._tracks_stamp_ns = message.stamp_ns
            motion = (vehicle.T_map_vehicle, vehicle.speed_mps or 0.0, vehicle.yaw_rate_radps or 0.0)
            self._alarm.update(find_threat(tabulate(message.tracks), sensor.age_s, *motion, self._config.roadside))
        threat = self._alarm.threat
        if self._alarm.level is None or threat is None:
            return replace(sensor, level=None)
        return replace(sensor, level=self._alarm.level, nearest_m=threat.distance_m, deciding=threat.deciding)

    def _inputs(
        self, seen: Observation, judged: Judged, vehicle: Vehicle, roadside: SensorInput | None
    ) -> FusionInputs:
        undated = [judged[name][1].reason for name in ONBOARD if judged[name][1].cause == "clock"]
        doubt = self._inbox.own_clock_doubt(seen.now_s)
        return FusionInputs(
            now_s=seen.now_s,
            moving=vehicle.moving,
            lidar=judged["lidar"][0],
            radar=judged["radar"][0],
            camera=judged["camera"][0],
            roadside=roadside,
            distrust=(doubt, *undated) if doubt else tuple(undated),
            starting=tuple(name for name in ONBOARD if not self._inbox.watches[name].reported),
            stamp_ns=seen.now_ns,
        )
