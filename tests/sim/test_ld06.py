"""The LD06 stream: bytes as in the manual, geometry as in the world."""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.geometry import rotation_rpy, transform
from spotter_sim import ld06
from spotter_sim.raycast import cast
from spotter_sim.solids import BOX, REFLECTIVITY, join, solid
from spotter_sim.world import T_vehicle_ld06, world_at

# The packet printed in LDROBOT's development manual.
MANUAL = bytes.fromhex(
    "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4 CA 00 E2 C7 00 E9 "
    "C5 00 E5 C2 00 E5 C0 00 E5 BE 82 3A 1A 50"
)


def decode(data: bytes):
    """A plain reading of the manual: (angles_deg, distances_mm, confidences, timestamps_ms), CRC checked."""
    angles, distances, confidences, stamps = [], [], [], []
    for at in range(0, len(data), 47):
        packet = data[at : at + 47]
        assert packet[:2] == b"\x54\x2c"
        assert ld06.crc8(packet[:46]) == packet[46]
        start = struct.unpack_from("<H", packet, 4)[0] / 100
        end, stamp = struct.unpack_from("<HH", packet, 42)
        angles += [(start + i * ((end / 100 - start) % 360) / 11) % 360 for i in range(12)]
        for i in range(12):
            d, c = struct.unpack_from("<HB", packet, 6 + 3 * i)
            distances.append(d)
            confidences.append(c)
        stamps.append(stamp)
    return np.array(angles), np.array(distances), np.array(confidences), np.array(stamps)


def test_crc_golden_values():
    assert ld06.crc8(b"123456789") == 0xC3
    assert (ld06.CRC_TABLE[1], ld06.CRC_TABLE[2], ld06.CRC_TABLE[255]) == (0x4D, 0x9A, 0xA8)
    assert ld06.crc8(MANUAL[:46]) == 0x50


def test_encode_packet_repeats_the_manuals_packet():
    distances = [struct.unpack_from("<H", MANUAL, 6 + 3 * i)[0] for i in range(12)]
    confidences = [MANUAL[8 + 3 * i] for i in range(12)]
    built = ld06.encode_packet(32427, 33470, np.array(distances), np.array(confidences), 0x1A3A, speed_dps=0x0868)
    assert built == MANUAL


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_encode_decodes_to_the_same_points(seed, count):
    rng = np.random.default_rng(seed)
    n = 12 * count
    angles = (rng.uniform(0, 360) + 0.8 * np.arange(n)) % 360
    distances, confidences = rng.integers(0, 12000, n), rng.integers(0, 256, n)
    got = decode(ld06.encode(angles, distances, confidences, start_ms=29_990.0))
    assert np.abs((got[0] - angles + 180) % 360 - 180).max() < 0.011
    np.testing.assert_array_equal(got[1], distances)
    np.testing.assert_array_equal(got[2], confidences)
    assert got[3].max() < 30_000


def test_encode_refuses_half_packets():
    with pytest.raises(ValueError, match="13 points"):
        ld06.encode(np.arange(13), np.zeros(13), np.zeros(13))


def test_rate_is_that_of_the_device():
    data = ld06.packets("crossing", 2.0, 4.0)
    assert len(data) == 2 * 375 * 47
    angles, _, _, stamps = decode(data)
    steps = np.diff(angles) % 360
    np.testing.assert_allclose(steps, 0.8, atol=0.011)
    assert set(np.diff(stamps) % 30_000) <= {2, 3}


def test_intervals_join_without_a_seam():
    whole = ld06.packets("crossing", 1.0, 1.5)
    cuts = [1.0, 1.0011, 1.1, 1.234567, 1.4999, 1.5]
    assert whole == b"".join(ld06.packets("crossing", a, b) for a, b in pairwise(cuts))


def test_an_interval_across_the_loop():
    assert ld06.packets("crossing", 14.9, 0.1) == ld06.packets("crossing", 14.9, 15.1)
    assert len(ld06.packets("crossing", 14.9, 0.1)) == 75 * 47


def test_the_same_time_gives_the_same_bytes():
    ld06._block.cache_clear()
    first = ld06.packets("crossing", 5.0, 5.2)
    ld06._block.cache_clear()
    assert ld06.packets("crossing", 5.0, 5.2) == first


def test_blocked_lens_sends_zeros_and_a_pulled_plug_nothing():
    _, distances, confidences, _ = decode(ld06.packets("faults", 5.0, 5.5))
    assert not distances.any()
    assert not confidences.any()
    assert ld06.packets("faults", 14.0, 15.0) == b""
    assert len(ld06.packets("faults", 19.0, 19.1)) > 0


def test_walls_all_round():
    _, distances, confidences, _ = decode(ld06.packets("empty", 1.0, 2.0))
    assert (distances > 0).mean() > 0.9
    strong = distances[confidences > 60]
    assert np.percentile(strong, 1) > 1000
    assert np.median(strong) < 8000


def test_left_is_left(one_actor):
    """A box at the left shows at clockwise angles of 270 to 360 degrees and gets y > 0 by the manual's formula."""
    left_box = solid(BOX, (2.0, 1.0, 0.5), (0.2, 0.2, 0.5), "wall", "concrete")
    scenario = one_actor("pedestrian", 200.0, 0.0, fixtures=left_box)
    angles, distances, confidences, _ = decode(ld06.packets(scenario, 0.0, 0.1))
    hit = (distances > 0) & (confidences > 60)
    assert hit.sum() > 5
    assert np.all(angles[hit] > 270.0)
    assert np.all(-distances[hit] * np.sin(np.radians(angles[hit])) > 600)


def test_noise_is_about_ten_millimetres(one_actor):
    front = join([solid(BOX, (3.1, 0.0, 0.5), (0.5, 5.0, 0.5), "wall", "concrete")])
    scenario = one_actor("pedestrian", 200.0, 0.0, fixtures=front)
    angles, distances, confidences, _ = decode(ld06.packets(scenario, 0.0, 3.0))
    ahead = ((angles < 5) | (angles > 355)) & (confidences > 60)
    x = distances[ahead] / 1000 * np.cos(np.radians(angles[ahead]))
    assert x.mean() == pytest.approx(2.5, abs=0.003)  # the lidar stands 0.1 m before the vehicle's middle
    assert 0.008 < x.std() < 0.012


def test_ghosts_are_faint_and_rare():
    _, distances, confidences, _ = decode(ld06.packets("empty", 0.0, 4.0))
    ghosts = (distances > 0) & (distances < 2500) & (confidences <= 30)
    assert 0.0005 < ghosts.mean() < 0.005


@pytest.mark.parametrize("t_s", [1.0, 4.4, 5.9, 9.0, 11.5, 14.0])
@pytest.mark.parametrize("turned", [False, True])
def test_ranges_against_every_ray_at_every_solid(t_s, turned):
    """The plain way: no table of fixtures, no actor left out; also with the vehicle driven off and tilted."""
    world = world_at("crossing", t_s)
    if turned:
        pose = transform(rotation_rpy(0.02, -0.015, 0.4), np.array([1.2, 0.5, 0.02]))
        world = replace(world, T_map_vehicle=pose)
    angles = np.radians(np.arange(0.0, 360.0, 1.6) + 0.3)
    T_map_lidar = world.T_map_vehicle @ T_vehicle_ld06
    rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)]) @ T_map_lidar[:3, :3].T
    solids = world.solids_near(T_map_lidar[:3, 3], ld06.RANGE_M[1])
    plain_m, index = cast(T_map_lidar[:3, 3], rays, solids, ld06.RANGE_M[1])
    range_m, reflectivity = ld06.slice_ranges(world, angles)
    np.testing.assert_allclose(range_m, plain_m, rtol=1e-12)
    np.testing.assert_array_equal(reflectivity, np.where(index >= 0, REFLECTIVITY[solids.part[index]], 0.0))
