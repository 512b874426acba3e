"""What R4 saves and what it costs: ``python -m benchmarks.onboard.suppression``; about two minutes.

No recording has lidar, camera and radar of the same moment. So a real laser drive is played with the other sensors as
suppression likes them best (online, clear, the picture fresh and empty); the recordings of camera and radar tell how
often that would have been wrong with somebody there. In the proving ground's innocent cases all sensors are simulated
together, and every alarm is false. The same inputs are decided with ``off``, ``limited`` and ``full``.
"""

from __future__ import annotations

import gzip
import heapq
import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np

from common.bus.pubsub import Received
from common.bus.status import Report
from common.messages import Level
from common.topics import SENSOR_TOPICS
from services.jetson.camera.config import CameraConfig, DetectorConfig
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.readings import read
from services.jetson.fusion.verdict import fuse
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.pipeline import LidarPipeline
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.recording import open_recording
from spotter_sim import ld06
from spotter_tools.prove.braked import FREE
from spotter_tools.prove.case import BEGINS_S, Case
from spotter_tools.prove.catalogue import innocents
from spotter_tools.prove.configs import configs_of
from spotter_tools.prove.loop import moving_world
from spotter_tools.prove.senses import START_NS, Arrival, Senses

DATA = Path(os.environ.get("SPOTTER_DATA", Path(__file__).parents[3] / "shared" / "data"))
CLEAR = SensorInput(state="online", level="SAFE", age_s=0.05)
EMPTY = SensorInput(state="online", level=None, age_s=0.05)
RULES = {name: RulesConfig(suppression=name) for name in ("off", "limited", "full")}
EVERY = 10  # pictures of the film at 10 Hz: one a second


def main() -> None:
    """Laser drive, film, radar recordings, innocent cases."""
    laser()
    film()
    radar()
    proving_ground()


def laser() -> None:
    """A Hokuyo carried through a room, packed as LD06 bytes; and the two real LD06 turns, standing."""
    folder = DATA / "laser2d-urg04lx"
    if not folder.is_dir():
        print(f"no {folder}: set SPOTTER_DATA")
        return
    with gzip.open(folder / "exp1.dat.gz", "rt") as lines:
        rows = np.array([[int(value) for value in line.split()[24:]] for line in lines])
    beam = np.round(((-np.arange(450) * 0.8 + 180.0) % 360.0 - 180.0 + 120.0) / 240.0 * 682).astype(int)
    turns = np.where((beam >= 0) & (beam < 683), rows[:, np.clip(beam, 0, 682)], 0)
    compare("Hokuyo URG-04LX, a real drive in a room", lone_lidar(turns))
    turns = [np.loadtxt(DATA / "ld06" / f"scan_ranges_{number}.txt") for number in (0, 1)]
    clockwise = np.round(np.arange(450) * 0.8).astype(int) % 360 - 1
    compare(
        "LD06, two real turns in a room, in turn",
        lone_lidar(np.array([1000 * turns[k % 2][clockwise] for k in range(100)])),
    )


def lone_lidar(mm: np.ndarray) -> Iterator[FusionInputs]:
    """Inputs per turn of (turns, 450) ranges, clockwise from ahead: the lidar's own, all others clear."""
    flat = mm.ravel()[: mm.size // 12 * 12]
    data = ld06.encode(np.arange(len(flat)) * 0.8, np.round(flat), np.where(flat > 0, 200, 0))
    decoder, pipeline = ScanDecoder(LidarConfig(), Report("bench")), LidarPipeline(LidarConfig())
    for number, at in enumerate(range(0, len(data), ld06.PACKET_BYTES)):
        for scan in decoder.feed(START_NS + round(number / 375.0 * 1e9), 0.0, data[at : at + ld06.PACKET_BYTES]):
            reading = read(pipeline.process(scan.stamp_ns, scan))
            lidar = SensorInput(
                state=reading.state, level=reading.level, age_s=0.02, nearest_m=reading.nearest_m,
                stamp_ns=scan.stamp_ns, sightings=reading.sightings, raw_level=reading.raw_level,
            )  # fmt: skip
            now_s = (scan.stamp_ns - START_NS) * 1e-9
            yield FusionInputs(now_s=now_s, moving=None, lidar=lidar, radar=CLEAR, camera=EMPTY)


def film() -> None:
    """How often the picture is empty between two pictures with a person, four seconds apart at most."""
    network, file = DATA / "camera" / "yolov8n_int8.onnx", DATA / "camera" / "one-by-one-person-detection.mp4"
    if not network.is_file() or not file.is_file():
        print(f"no {file}: set SPOTTER_DATA")
        return
    pipeline = CameraPipeline(CameraConfig(source="file:", detector=DetectorConfig(model=str(network), confidence=0.3)))
    shown, pictures = [], cv2.VideoCapture(str(file))
    for number in itertools.count():
        there, image = pictures.read()
        if not there:
            break
        if number % EVERY == 0:
            seen = pipeline.process(number * 100_000_000, image)
            shown.append(any(one.label == "person" for one in seen.detections))
    found = np.flatnonzero(shown)
    gaps = [after - before - 1 for before, after in itertools.pairwise(found) if 1 < after - before <= 4]
    print(f"film of one person at a time, {len(shown)} pictures: {len(found)} show the person,")
    print(
        f"  {sum(gaps)} between them do not ({100 * sum(gaps) / (sum(gaps) + len(found)):.0f} % of those with a person)"
    )


def radar() -> None:
    """How often the radar is clear with somebody there: then it does not end a suppression either."""
    for name, who in (
        ("seated_person_breathing", "a person sits at 0.33 m"),
        ("moving_hand_first_half", "a hand at 0.2 to 0.5 m"),
    ):
        if not (DATA / "radar-bgt60tr13c" / name).is_dir():
            print(f"no recording {name}: set SPOTTER_DATA")
            continue
        recorded = open_recording(DATA / "radar-bgt60tr13c" / name)
        pipeline = RadarPipeline(msgspec.structs.replace(RadarConfig(), waveform=recorded.waveform))
        settled = [one for one in (pipeline.process(stamp, frame) for stamp, frame in recorded) if one.settled]
        clear = sum(read(one).level == "SAFE" for one in settled)
        print(f"radar, {who}: clear in {clear} of {len(settled)} settled frames")


def proving_ground() -> None:
    """The innocent cases at 2 m/s, undisturbed by brakes: any alarm is false."""
    cases = [case for case in innocents() if ", 2 m/s" in case.name]
    compare(f"{len(cases)} innocent cases at 2 m/s", *(driven(case) for case in cases))


def driven(case: Case) -> Iterator[FusionInputs]:
    """The inputs of every verdict of a drive without brakes, from ``BEGINS_S`` on."""
    scenario, vehicle = moving_world(case)
    configs = configs_of(case.preset)
    senses, fusion = Senses(scenario, configs, ego=case.ego), FusionPipeline(configs.fusion)
    hosts = {name: getattr(configs.fusion.sensors, name).host for name in SENSOR_TOPICS}
    present = frozenset((hosts[name], topic.service, "x") for name, topic in SENSOR_TOPICS.items())
    due = [(period_s, name) for name, period_s in senses.periods.items()]
    on_the_way: list[tuple[float, int, Arrival]] = []
    number = itertools.count()
    while due[0][0] < case.ends_s:
        now_s, name = due[0]
        heapq.heapreplace(due, (now_s + senses.periods[name], name))
        vehicle.advance(now_s, FREE)
        for arrival in senses.measure(name, now_s):
            heapq.heappush(on_the_way, (arrival.at_s, next(number), arrival))
        received = []
        while on_the_way and on_the_way[0][0] <= now_s:
            at_s, _, arrival = heapq.heappop(on_the_way)
            received.append(Received(arrival.key, arrival.message, at_s, START_NS + round(at_s * 1e9)))
        fusion.process(Observation(now_s, START_NS + round(now_s * 1e9), tuple(received), present))
        if fusion.step is not None and now_s >= BEGINS_S:
            yield fusion.step.inputs


def compare(what: str, *drives: list[FusionInputs] | Iterator[FusionInputs]) -> None:
    """Seconds of alarm, alarms, and seconds held back, by what suppression may do."""
    simulated = [list(drive) for drive in drives]
    print(f"{what}, {sum(one[-1].now_s - one[0].now_s for one in simulated):.0f} s")
    for name, rules in RULES.items():
        alarm_s = held_s = 0.0
        alarms = 0
        for drive in simulated:
            before: Level = "SAFE"
            memory = FusionMemory()
            for inputs, after in itertools.pairwise(drive):
                verdict, memory = fuse(inputs, memory, rules)
                step_s = after.now_s - inputs.now_s
                alarm_s += step_s * (verdict.level != "SAFE")
                held_s += step_s * verdict.suppressed
                alarms += verdict.level != "SAFE" and before == "SAFE"
                before = verdict.level
        print(f"  {name:8} alarm {alarm_s:6.1f} s, {alarms:3d} times; held back {held_s:5.1f} s")


if __name__ == "__main__":
    main()
