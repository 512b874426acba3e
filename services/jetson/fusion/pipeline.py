"""Observations in, verdict and health out. No network, no clock: the time is part of the observation."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

from common.messages import Cover, Motion, ObjectTracks, SensorHealth, SystemHealth, Verdict
from common.topics import ONBOARD_SENSORS
from services.jetson.fusion.abreast import AbreastWatch, Dated
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.coverage import Coverage, cover_way
from services.jetson.fusion.evidence import Abreast, FusionInputs, FusionMemory, Place, SensorInput, Sighting
from services.jetson.fusion.inbox import Inbox
from services.jetson.fusion.latency import LatencyBook
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.reporter import Reporter
from services.jetson.fusion.roadside import RoadsideWatch, Threat
from services.jetson.fusion.store import Saved, resumed
from services.jetson.fusion.vehicle import Vehicle
from services.jetson.fusion.verdict import fuse


class Step(NamedTuple):
    """The inputs of one verdict and the memory before it: enough to decide it again."""

    inputs: FusionInputs
    memory: FusionMemory


Judged = dict[str, tuple[SensorInput, SensorHealth]]

RESUME_S = 60.0  # a gap no longer than this is a restart: start-up is not begun anew
ROADSIDE_RADIUS_M = 0.5
NOT_FITTED = SensorInput(state="disconnected", level=None, reason="not fitted", fitted=False)


class FusionPipeline:
    """``process`` every observation: on every input and at least at the verdict's period.

    ``saved`` is what an earlier process remembered: alarms outlive it, and a short gap is no new start-up.
    """

    def __init__(self, config: FusionConfig, saved: Saved | None = None) -> None:
        self._config = config
        self._inbox = Inbox(config)
        self._saved = saved
        self._memory = FusionMemory()
        self._begun_s: float | None = None  # when start-up began, monotonic
        self._reported: frozenset[str] = frozenset()  # to the process before us
        self.step: Step | None = None  # what the last verdict was decided from
        self._alarm = RoadsideWatch(config.roadside)
        self._abreasts = AbreastWatch(config.path)
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
        if self._begun_s is None:
            self._begin(seen)
        # 1. what arrived goes to the sensor it is about
        link = self._inbox.sort(seen)
        # 2. the state of every sensor: network, process, device, data, clock
        judged: Judged = {
            name: watch.judge(seen.now_s, seen.now_ns, link[name]) for name, watch in self._inbox.watches.items()
        }
        # 3. what the roadside means for the vehicle
        vehicle = self._inbox.own_speed.judge(seen.now_s, self._inbox.ego.now(seen.now_s))
        roadside = self._from_roadside(judged["infra_lidar"][0], vehicle) if "infra_lidar" in judged else None
        # 4. the verdict, by the rules
        inputs = self._inputs(seen, judged, vehicle, roadside)
        self.step = Step(inputs, self._memory)
        verdict, self._memory = fuse(inputs, self._memory, self._config.rules)
        # 5. how old was all that
        self.latency.add({name: sensor for name, (sensor, _) in judged.items()})
        # 6. health for people, when there is news
        return verdict, self._reporter.report(seen, {name: health for name, (_, health) in judged.items()})

    def state(self, seen: Observation) -> Saved:
        """What a successor has to know, after the verdict of this observation."""
        begun_s = seen.now_s if self._begun_s is None else self._begun_s
        sensors = {
            name: watch.recovery.habit(watch.state, reported=self._has_reported(name))
            for name, watch in self._inbox.watches.items()
        }
        return Saved(seen.now_ns, seen.now_s, begun_s, self._memory, sensors)

    def _begin(self, seen: Observation) -> None:
        """Go on with what was saved; without it, or after a long gap, start-up begins now."""
        self._begun_s = seen.now_s
        if self._saved is None:
            return
        saved = resumed(self._saved, seen.now_s, seen.now_ns)
        self._memory = saved.memory
        if not 0.0 <= self._saved.gap_s(seen.now_s, seen.now_ns) <= RESUME_S:
            return
        self._begun_s = saved.begun_s
        self._reported = frozenset(name for name, habit in saved.sensors.items() if habit.reported)
        for name, watch in self._inbox.watches.items():
            if name in saved.sensors:
                watch.recovery.resume(seen.now_s, saved.sensors[name])

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
            self._alarm.take(message, sensor.age_s, vehicle)
        threat = self._alarm.threat
        if self._alarm.level is None or threat is None:
            return replace(sensor, level=None)
        seen = (Sighting(self._alarm.level, _place_of(threat), str(threat.deciding.get("label", ""))),)
        known = {"nearest_m": threat.distance_m, "deciding": threat.deciding, "sightings": seen}
        return replace(sensor, level=self._alarm.level, **known)  # type: ignore[arg-type]

    def _has_reported(self, name: str) -> bool:
        return self._inbox.watches[name].reported or name in self._reported

    def _inputs(
        self, seen: Observation, judged: Judged, vehicle: Vehicle, roadside: SensorInput | None
    ) -> FusionInputs:
        fitted = [name for name in ONBOARD_SENSORS if name in judged]
        undated = [judged[name][1].reason for name in fitted if judged[name][1].cause == "clock"]
        doubt = self._inbox.own_clock_doubt(seen.now_s)
        onboard = {name: judged[name][0] for name in fitted}
        waiting = self._begun_s is not None and seen.now_s - self._begun_s < self._config.health.start_s
        return FusionInputs(
            now_s=seen.now_s,
            moving=vehicle.moving,
            lidar=onboard.pop("lidar", NOT_FITTED),
            radar=onboard.pop("radar", NOT_FITTED),
            camera=onboard.pop("camera", NOT_FITTED),
            others=onboard,
            roadside=roadside,
            distrust=(doubt, *undated) if doubt else tuple(undated),
            starting=tuple(name for name in fitted if waiting and not self._has_reported(name)),
            stamp_ns=seen.now_ns,
            motion_kind=vehicle.source_kind,
            speed_mps=vehicle.speed_mps,
            yaw_rate_radps=vehicle.yaw_rate_radps,
            acknowledged=seen.acknowledged,
            coverage=self._coverage(judged, vehicle),
            abreast=self._abreast(judged, vehicle),
        )

    def _abreast(self, judged: Judged, vehicle: Vehicle) -> Abreast | None:
        """Radar alarms that an online lidar shows as two things beside the way."""
        if not self._config.rules.abreast or "radar" not in judged or "lidar" not in judged:
            return None
        dated: list[Any] = []
        for name in ("radar", "lidar"):
            frame, sensor = self._inbox.watches[name].frame, judged[name][0]
            if sensor.state != "online" or frame is None or sensor.age_s is None:
                return None
            dated += [frame.received.message, sensor.age_s]
        return self._abreasts.set_aside(Dated(*dated), _motion_of(vehicle))

    def _coverage(self, judged: Judged, vehicle: Vehicle) -> Coverage | None:
        """What the onboard sensors that are online could have seen of the way ahead."""
        if self._config.rules.coverage == "off":
            return None
        covers: dict[str, Cover | None] = {}
        out: dict[str, str] = {}
        for name in ONBOARD_SENSORS:
            if name not in judged:
                continue
            frame, state = self._inbox.watches[name].frame, judged[name][0].state
            if state == "online" and frame is not None:
                covers[name] = getattr(frame.received.message, "cover", None)
            else:
                out[name] = state
        return cover_way(_motion_of(vehicle), self._config.path, covers, out, self._config.rules)


def _motion_of(vehicle: Vehicle) -> Motion | None:
    return None if vehicle.speed_mps is None else Motion(vehicle.speed_mps, vehicle.yaw_rate_radps or 0.0)


def _place_of(threat: Threat) -> Place | None:
    """Where the roadside sees it, in the vehicle's frame."""
    position = threat.deciding.get("position_m")
    return Place(position[0], position[1], ROADSIDE_RADIUS_M) if isinstance(position, list) else None
