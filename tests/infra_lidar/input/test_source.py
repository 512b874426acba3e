"""Where frames come from: files in order, at their pace, and packets over a real socket."""

import itertools
import socket
import struct

import numpy as np
import pytest

from common.clock import monotonic_s
from common.config import ConfigError
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.live_packets import Receiver
from services.infra_lidar.input.range_image import count_of
from services.infra_lidar.input.senders import print_senders
from services.infra_lidar.input.source import open_source, surveyed_pose
from services.infra_lidar.input.velodyne import Vls128Parser
from tests.infra_lidar.made_packets import metadata

CLOUD = np.arange(15, dtype=np.float32).reshape(3, 5)


def _open(url, report):
    return open_source(InfraLidarConfig(source=url), report)


def _folder(path, count=3, **more):
    for k in range(count):
        np.savez(path / f"frame_{k}.npz", xyz=CLOUD[:, :3] + k, stamp=np.float64(100.0 + 0.1 * k), **more)
    return path


def test_a_folder_ends_or_begins_again(tmp_path, report):
    _folder(tmp_path)
    frames = list(_open(f"file:{tmp_path}?rate=0", report))
    assert [f.points[0, 0] for _, f in frames] == [0, 1, 2]
    stamps = [s for s, _ in frames]
    assert np.allclose(np.diff(stamps), 1e8, rtol=1e-5)
    again = list(itertools.islice(_open(f"file:{tmp_path}?rate=0&loop=1", report), 7))
    assert [f.points[0, 0] for _, f in again] == [0, 1, 2, 0, 1, 2, 0]
    assert (np.diff([s for s, _ in again]) > 0).all()


def test_frames_far_apart_are_shown_at_the_nominal_rate(tmp_path, report):
    for k in range(2):
        np.savez(tmp_path / f"frame_{k}.npz", xyz=CLOUD[:, :3], stamp=np.float64(100.0 + 20.0 * k))
    (first, _), (second, _) = _open(f"file:{tmp_path}?rate=0", report)
    assert second - first == 100_000_000


def test_playing_takes_as_long_as_the_recording_or_longer(tmp_path, report):
    before_s = monotonic_s()
    stamps = [s for s, _ in _open(f"file:{_folder(tmp_path)}?rate=4", report)]
    assert monotonic_s() - before_s >= 3 * 0.1 / 4 - 0.01
    assert (np.diff(stamps) > 0).all()


def test_an_unreadable_frame_is_counted_and_left_out(tmp_path, report):
    _folder(tmp_path)
    (tmp_path / "frame_1.npz").write_bytes(b"damaged")
    assert len(list(_open(f"file:{tmp_path}?rate=0", report))) == 2
    assert report.snapshot().counters == {"unreadable frame": 1}


def test_single_files_and_other_suffixes(tmp_path, report):
    (tmp_path / "1700000000000000000.bin").write_bytes(CLOUD.tobytes())
    (frame,) = [f for _, f in _open(f"file:{tmp_path}?rate=0", report)]
    assert np.array_equal(frame.points, CLOUD)
    assert len(list(_open(f"file:{tmp_path}/1700000000000000000.bin?rate=0", report))) == 1


@pytest.mark.parametrize(
    "url",
    ["file:/no/such/place", "velodyne://:nowhere", "laser:x", "file:{empty}", "file:{other}", "file:{pcap}",
     "ouster://127.0.0.1?metadata=/no/such.json", "file:{broken}?rate=0"],
)  # fmt: skip
def test_what_cannot_be_opened_is_refused_with_a_reason(tmp_path, report, url):
    for name in ("empty", "broken"):
        (tmp_path / name).mkdir()
    (tmp_path / "broken" / "a.npz").write_bytes(b"damaged")
    (tmp_path / "other").write_text("text")
    (tmp_path / "a.pcap").write_bytes(b"no capture")
    url = url.format(
        empty=tmp_path / "empty", other=tmp_path / "other", pcap=tmp_path / "a.pcap", broken=tmp_path / "broken"
    )
    with pytest.raises(ConfigError):
        list(_open(url, report))


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("sim:crossing?rate_hz=0", "rate_hz=0: expected more than 0"),
        ("sim:crossing?rate_hz=-2", "rate_hz=-2: expected more than 0"),
        ("sim:crossing?rate_hz=inf", "rate_hz='inf' is not a finite number"),
        ("sim:crossing?columns=0", "columns=0: expected 1 or more"),
        ("sim:crossing?columns=-5", "columns=-5: expected 1 or more"),
        ("velodyne://:70000", r"PORT of velodyne://\[ADDRESS\]:PORT: expected a port from 1 to 65535, found '70000'"),
        ("ouster://127.0.0.1?metadata={metadata}&port=70000", "port: expected a port from 1 to 65535, found '70000'"),
        ("robosense://127.0.0.1?difop=70000", "difop: expected a port from 1 to 65535, found '70000'"),
    ],
)
def test_a_number_out_of_range_is_refused_in_a_sentence(tmp_path, report, url, words):
    path = tmp_path / "metadata.json"
    path.write_text(metadata())
    with pytest.raises(ConfigError, match=words):
        next(iter(_open(url.format(metadata=path), report)))


def test_a_receiver_refuses_a_port_out_of_range(report):
    with pytest.raises(ConfigError, match="cannot listen on UDP port 70000"):
        Receiver("", 70000, Vls128Parser(), report)


def _packet(azimuth_deg, time_us):
    blocks = b""
    for block in range(12):
        flag = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)[block % 4]
        blocks += struct.pack("<HH", flag, round(azimuth_deg * 100) % 36000) + struct.pack("<HB", 2500, 77) * 32
    return blocks + struct.pack("<IBB", time_us, 0x37, 0xA1)


def test_packets_over_a_socket_become_revolutions(report):
    receiver = Receiver("127.0.0.1", 0, Vls128Parser(), report)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sender.sendto(b"a stranger", ("127.0.0.1", receiver.port))
        for k in range(0, 130):  # 3 degrees a packet: a revolution and a bit
            sender.sendto(_packet((3 * k) % 360, 166 * k), ("127.0.0.1", receiver.port))
        revolution = receiver.next(20.0)
        assert revolution is not None
        assert len(revolution.points) > 300 * 12
        assert receiver.next(0.01) is None
        assert report.snapshot().counters["packet of another kind"] == 1
    finally:
        sender.close()
        receiver.close()


def test_late_frames_make_room_for_new_ones(report, until):
    receiver = Receiver("127.0.0.1", 0, Vls128Parser(), report)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        for k in range(0, 12 * 8 + 2):  # eight revolutions of twelve packets, none is taken
            sender.sendto(_packet((30 * k) % 360, 166 * k), ("127.0.0.1", receiver.port))
        counters, alive = lambda: report.snapshot().counters, receiver._thread.is_alive
        until(lambda: counters().get("incomplete revolution", 0) >= 8 or not alive())
        assert alive()
        assert report.snapshot().dropped >= 5
        assert receiver.next(5.0) is not None
    finally:
        sender.close()
        receiver.close()


def test_a_taken_port_is_a_wrong_configuration(report):
    receiver = Receiver("127.0.0.1", 0, Vls128Parser(), report)
    try:
        with pytest.raises(ConfigError, match="cannot listen"):
            Receiver("127.0.0.1", receiver.port, Vls128Parser(), report)
    finally:
        receiver.close()


def test_the_simulated_pole_knows_where_it_stands(report):
    stamp_ns, frame = next(iter(_open("sim:crossing?t0=2&columns=600", report)))
    assert frame.points.shape[1] == 5
    assert frame.received_ns >= stamp_ns
    assert len(surveyed_pose(InfraLidarConfig(source="sim:crossing"))) == 16
    assert surveyed_pose(InfraLidarConfig(source="file:/x")) == ()


def test_recorded_packets_are_a_source(recording, report):
    path = recording("lidar128-velodyne-vls128") / "vls128_packets.db3"
    frames = [frame for _, frame in _open(f"file:{path}?rate=0", report)]
    assert [frame.quality.complete for frame in frames] == [False, True, True, True]
    assert all(count_of(frame.returns) > 200_000 for frame in frames[1:])
    capture = recording("lidar128-ouster-os2") / "OS-2-128.pcap"
    (frame,) = [frame for _, frame in _open(f"file:{capture}?rate=0", report)]
    assert count_of(frame.returns) == 119_682
    assert frame.points.shape == (1024 * 128, 5)


@pytest.mark.parametrize("suffix", [".MCAP", ".Db3", ".BAG"])
def test_a_name_in_capitals_is_a_bags(tmp_path, report, suffix):
    file = tmp_path / f"street{suffix}"
    file.write_bytes(b"")
    words = rf"name has to end in {suffix.lower()}, found {suffix}: rename it"
    with pytest.raises(ConfigError, match=words):
        _open(f"file:{file}", report)
    with pytest.raises(ConfigError, match=words):
        print_senders(str(file), 1.0)
