"""Raw bytes: tapped only while wanted, recorded whole, and processed again to exactly what was published."""

from __future__ import annotations

import json
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from common import pacing, topics
from common.bus.raw_tap import RawTap, changes, with_changes
from common.bus.session import open_session
from common.bus.status import Report
from common.codec import encode
from common.config import ConfigError, ZenohConfig
from common.messages import Message, Motion, RawBytes
from common.recording import raw as raw_source
from common.recording.file import RecordingFile
from common.recording.raw import PERIOD_NS, pieces, replayed
from common.source_url import SourceUrl
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.packets import Frame
from services.infra_lidar.input.raw import publish_raw, recorded_frames
from services.infra_lidar.input.velodyne import Vls128Parser
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.pipeline import LidarPipeline
from services.radar_pi.config import RadarConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from spotter_sim import bgt60, camera, ld06, lidar128
from spotter_tools.reprocess import SERVICES, verify_service

T0 = 1_795_000_000_000_000_000
Made = Iterator[Message]
RECORDINGS: dict[str, Callable[[RawTap], Made]] = {}


class Outlet:
    """A publisher whose listener comes and goes."""

    def __init__(self, wanted: bool = True) -> None:
        self.wanted = wanted
        self.sent: list[RawBytes] = []

    def __call__(self, message: RawBytes) -> None:
        self.sent.append(message)


def records(service: str) -> Callable[[Callable[[RawTap], Made]], Callable[[RawTap], Made]]:
    def note(make: Callable[[RawTap], Made]) -> Callable[[RawTap], Made]:
        RECORDINGS[service] = make
        return make

    return note


@records("lidar")
def lidar(raw: RawTap) -> Made:
    decoder, pipeline = ScanDecoder(LidarConfig(), Report("test")), LidarPipeline(LidarConfig())
    for tick in range(250):
        arrival_ns, data = T0 + tick * 10_000_000, ld06.packets("crossing", tick * 0.01, tick * 0.01 + 0.01)
        raw("ld06", arrival_ns, data, epoch=decoder.restarts)
        for scan in decoder.feed(arrival_ns, tick * 0.01, data):
            yield pipeline.process(scan.stamp_ns, scan)


@records("radar")
def radar(raw: RawTap) -> Made:
    config = RadarConfig()
    raw.about["fitted"] = {"waveform": msgspec.to_builtins(config.waveform)}
    pipeline = RadarPipeline(config)
    for i in range(25):
        samples = bgt60.frame("crossing", 4.0 + 0.1 * i, simulator_waveform(config.waveform))
        motion = Motion(1.0 + 0.01 * i)
        raw("bgt60", T0 + i * 100_000_000, samples, T0 + i * 100_000_000 + 7, 0, note="", motion=motion)
        yield pipeline.process(T0 + i * 100_000_000, samples, motion, 0, "")


@records("camera")
def pictures(raw: RawTap) -> Made:
    pipeline = CameraPipeline(CameraConfig())
    for i in range(6):
        image = camera.image("crossing", 5.0 + 0.2 * i, 640, 480)
        raw("bgr8", T0 + i * 66_666_667, image, T0 + i * 66_666_667 + 9)
        yield pipeline.process(T0 + i * 66_666_667, image)


@records("infra_lidar")
def roadside(raw: RawTap) -> Made:
    pipeline = InfraLidarPipeline(InfraLidarConfig())
    for i in range(12):
        scan = lidar128.scan("crossing", 3.0 + 0.1 * i, 600)
        frame = Frame(np.column_stack([scan.xyz, scan.intensity, scan.ring]).astype(np.float32), T0 + i)
        publish_raw(raw, T0 + i * 100_000_000, frame)
        yield pipeline.process(T0 + i * 100_000_000, frame.points, frame.quality, frame.received_ns).tracks


def record(path: Path, service: str, spoil: Callable[[RawBytes], RawBytes | None] = lambda piece: piece) -> Path:
    """A recording of the service's raw bytes and results; ``spoil`` changes pieces, or leaves them out."""
    one, outlet = SERVICES[service], Outlet()
    with RecordingFile(path, {}) as file:
        for result in RECORDINGS[service](RawTap(outlet)):
            for piece in filter(None, map(spoil, outlet.sent)):
                file.add(one.raw.key("host0"), RawBytes, encode(piece), piece.stamp_ns, 0, piece.index)
            outlet.sent.clear()
            file.add(one.result.key("host0"), type(result), encode(result), result.stamp_ns, 0, 0)
    return path


@pytest.mark.parametrize("service", SERVICES)
def test_results_from_raw_bytes_are_those_that_were_published(tmp_path: Path, service: str) -> None:
    outcome = verify_service(service, record(tmp_path / "a.mcap", service))
    assert outcome.difference == ""
    assert outcome.compared == outcome.identical > 5


@pytest.mark.parametrize("service", ["lidar", "radar"])
def test_changed_bytes_are_found(tmp_path: Path, service: str) -> None:
    def spoil(piece: RawBytes) -> RawBytes:
        if 10 <= piece.index < 60:
            return msgspec.structs.replace(piece, data=np.flip(piece.data, axis=-1).copy())
        return piece

    outcome = verify_service(service, record(tmp_path / "a.mcap", service, spoil))
    assert outcome.difference
    assert outcome.identical < outcome.compared or "do not come again" in outcome.difference


def test_a_lost_piece_is_no_reason_to_guess(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", "radar", lambda piece: None if piece.index == 7 else piece)
    with pytest.raises(ConfigError, match="go on after piece 6 with piece 8"):
        verify_service("radar", path)
    path = record(tmp_path / "b.mcap", "radar", lambda piece: None if piece.index < 3 else piece)
    with pytest.raises(ConfigError, match="before the service"):
        verify_service("radar", path)


def test_packets_of_a_128_beam_lidar_become_the_same_points(tmp_path: Path) -> None:
    block = b"".join(struct.pack("<HH", flag, 0) + struct.pack("<HB", 2500, 77) * 32 for flag in FLAGS * 3)
    parser, outlet, frames = Vls128Parser(), Outlet(), []
    tap = RawTap(outlet)
    for k in range(1900):
        packet = bytearray(block + struct.pack("<IBB", 166 * k, 0x37, 0xA1))
        for at in range(12):
            struct.pack_into("<H", packet, 100 * at + 2, (60 * k + 20 * (at // 4)) % 36000)
        if (one := parser.feed(bytes(packet), T0 + k)) is not None:
            frames.append(one)
            publish_raw(tap, one.stamp_ns, Frame(one.points, one.stamp_ns, one.quality, one.packets, one.metadata))
    with RecordingFile(tmp_path / "a.mcap", {}) as file:
        for piece in outlet.sent:
            assert piece.kind == "velodyne"
            file.add("infra0/infra_lidar/raw", RawBytes, encode(piece), piece.stamp_ns, 0, 0)
    again = list(recorded_frames(SourceUrl("mcap", str(tmp_path / "a.mcap"), {"rate": "0"})))
    assert len(again) == len(frames) == 3
    for before, (stamp_ns, after) in zip(frames, again, strict=True):
        assert stamp_ns == before.stamp_ns
        assert after.quality == before.quality
        np.testing.assert_array_equal(after.points, before.points)


FLAGS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)


def test_a_listener_that_was_there_first_gets_the_first_piece() -> None:
    outlet = Outlet(wanted=False)
    tap = RawTap(outlet)
    for i in range(3):  # nobody has been found yet
        tap("ld06", T0 + i, bytes([i]))
    outlet.wanted = True
    tap("ld06", T0 + 3, b"\x03")
    assert [(piece.index, piece.data.tolist()) for piece in outlet.sent] == [(0, [0]), (1, [1]), (2, [2]), (3, [3])]


def test_nothing_is_kept_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [10.0]
    monkeypatch.setattr("common.bus.raw_tap.monotonic_s", lambda: now_s[0])
    outlet, made = Outlet(wanted=False), []
    tap = RawTap(outlet)
    tap("ld06", T0, b"\x00")
    now_s[0] += 60.0
    tap("bgr8", T0, lambda: made.append("a picture") or np.zeros(1, np.uint8))
    outlet.wanted = True
    tap("ld06", T0 + 2, b"\x02")
    assert [piece.index for piece in outlet.sent] == [2]
    assert made == []


def write_pieces(path: Path, keys: tuple[str, ...] = ("jetson0/lidar/raw",), count: int = 5) -> SourceUrl:
    with RecordingFile(path, {}) as file:
        for i in range(count):
            for key in keys:
                piece = RawBytes(stamp_ns=T0 + i * 20_000_000, kind="ld06", index=i, data=np.array([i], np.uint8))
                file.add(key, RawBytes, encode(piece), piece.stamp_ns, 0, i)
    return SourceUrl("mcap", str(path))


def test_at_rate_one_all_stamps_move_by_the_same_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (raw_source, pacing):
        monkeypatch.setattr(module, "monotonic_s", lambda: 100.0)
    monkeypatch.setattr(raw_source, "utc_ns", lambda: T0 + 10**15)
    waits: list[float] = []
    url = write_pieces(tmp_path / "a.mcap")
    assert [p.stamp_ns for p in replayed(url, topics.LIDAR_RAW, waits.append)] == [
        T0 + 10**15 + i * 20_000_000 for i in range(5)
    ]
    np.testing.assert_allclose(waits, [0.0, 0.02, 0.04, 0.06, 0.08], atol=1e-9)
    url.params["rate"] = "2"
    assert [p.stamp_ns - T0 - 10**15 for p in replayed(url, topics.LIDAR_RAW, waits.append)][-1] == 40_000_000
    url.params["rate"] = "0"
    assert [p.stamp_ns for p in replayed(url, topics.LIDAR_RAW)] == [T0 + i * 20_000_000 for i in range(5)]


@pytest.mark.parametrize("jump_ns", [10**18, -(10**18), -5 * 10**9], ids=["years ahead", "years back", "seconds back"])
def test_a_recording_in_which_the_clock_was_set_is_played_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jump_ns: int
) -> None:
    for module in (raw_source, pacing):
        monkeypatch.setattr(module, "monotonic_s", lambda: 100.0)
    stamps_ns = [T0, T0 + 20_000_000, T0 + jump_ns + 40_000_000, T0 + jump_ns + 60_000_000]
    with RecordingFile(tmp_path / "a.mcap", {}) as file:
        for i, stamp_ns in enumerate(stamps_ns):
            piece = RawBytes(stamp_ns=stamp_ns, kind="ld06", index=i, data=np.array([i], np.uint8))
            file.add("jetson0/lidar/raw", RawBytes, encode(piece), T0 + i, 0, i)
    waits: list[float] = []
    played = [p.stamp_ns for p in replayed(SourceUrl("mcap", str(tmp_path / "a.mcap")), topics.LIDAR_RAW, waits.append)]
    assert np.diff(played).tolist() == [20_000_000, PERIOD_NS, 20_000_000]
    assert max(waits) < 0.2


def test_what_cannot_be_played_is_said(tmp_path: Path) -> None:
    url = write_pieces(tmp_path / "a.mcap", ("jetson0/lidar/raw", "jetson1/lidar/raw"))
    with pytest.raises(ConfigError, match="choose one with"):
        list(pieces(url, topics.LIDAR_RAW))
    url.params["host"] = "jetson1"
    assert len(list(pieces(url, topics.LIDAR_RAW))) == 5
    with pytest.raises(ConfigError, match="--raw radar"):
        list(pieces(url, topics.RADAR_RAW))
    with pytest.raises(ConfigError, match="No such file"):
        list(pieces(SourceUrl("mcap", str(tmp_path / "none.mcap")), topics.RADAR_RAW))
    (tmp_path / "b.mcap").write_bytes(b"not a recording, but long enough for one")
    with pytest.raises(ConfigError, match="not an MCAP file"):
        list(pieces(SourceUrl("mcap", str(tmp_path / "b.mcap")), topics.RADAR_RAW))


def test_what_a_source_knew_of_itself_is_laid_over_another_configuration() -> None:
    plain = CameraConfig()
    fitted = msgspec.structs.replace(plain, lens=msgspec.structs.replace(plain.lens, f_x_px=123.0))
    known = changes(plain, fitted)
    assert list(known) == ["lens"]
    assert with_changes(plain, known) == fitted
    with pytest.raises(ConfigError, match="does not fit"):
        with_changes(plain, {"lens": {"f_x_px": "wide"}})


@pytest.mark.system
@pytest.mark.slow
def test_a_live_lidar_is_recorded_with_its_bytes_and_comes_out_the_same(
    router_endpoint: str, tmp_path: Path, spawn: Callable[..., Any], until: Callable[..., None]
) -> None:
    recorder = spawn(
        "spotter", "record", tmp_path, "--raw", "lidar", "--connect", router_endpoint, "--keep-free", "0", "--json"
    )
    until(lambda: list(tmp_path.glob("*.mcap")))
    service = spawn("spotter-lidar", "--source", "sim:crossing?t0=3", "--set", f'zenoh.connect=["{router_endpoint}"]')
    threading.Event().wait(4.0)  # what is recorded, not what is waited for
    service.terminate()
    service.wait(10)
    recorder.terminate()
    report = json.loads(recorder.communicate(timeout=20)[0])
    verified = spawn("spotter", "replay", "--verify", "--service", "lidar", report["file"], "--json")
    outcome = json.loads(verified.communicate(timeout=60)[0])
    assert outcome["difference"] == ""
    assert outcome["compared"] == outcome["identical"] > 20
    received = threading.Event()
    apart = ZenohConfig(connect=(router_endpoint,), namespace="replay")
    with open_session(apart) as listener:
        subscriber = listener.declare_subscriber("jetson0/lidar/zones", lambda _: received.set())
        spawn(
            "spotter-lidar", "--source", f"mcap:{report['file']}", "--set", "zenoh.namespace=replay",
            "--set", f'zenoh.connect=["{router_endpoint}"]',
        )  # fmt: skip
        assert received.wait(20)
        del subscriber
