"""Both detectors against slow plain loops, at the edges, and against theory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from benchmarks.radar.radar_accuracy import detection_rate, detection_theory, false_alarm_rate
from benchmarks.radar.radar_reference import cfar_hits, os_hits
from services.radar_pi.cfar import Hits, build_cfar
from services.radar_pi.cfar_design import ca_scale, os_mean_ratio, os_p_fa, os_scale
from services.radar_pi.config import CfarConfig
from services.radar_pi.noise import RowNoise, noise_floor_db

ROWS, COLUMNS = 20, 24


def cells(hits: Hits) -> set[tuple[int, int]]:
    return set(zip(hits.row.tolist(), hits.column.tolist(), strict=True))


def noise_map(seed: int, rows: int = ROWS, columns: int = COLUMNS, looks: int = 3) -> np.ndarray:
    return (np.random.default_rng(seed).gamma(looks, 1.0 / looks, (rows, columns))).astype(np.float32)


@pytest.mark.parametrize("excise_db", [0.0, 8.0])
@pytest.mark.parametrize("seed", range(4))
def test_cell_averaging_agrees_with_plain_loops(seed: int, excise_db: float) -> None:
    power = noise_map(seed)
    power[::7, ::5] *= np.float32(30.0)
    power[8:12, 3:9] *= np.float32(200.0)
    config = CfarConfig(threshold_db=7.0, excise_db=excise_db)
    fast = cells(build_cfar(config, ROWS, COLUMNS, 3).detect(power))
    assert fast == set(cfar_hits(power.astype(float), config, 3))
    assert fast


@pytest.mark.parametrize("seed", range(4))
def test_ordered_statistic_agrees_with_plain_loops(seed: int) -> None:
    power = noise_map(seed)
    power[::7, ::5] *= np.float32(30.0)
    config = CfarConfig(kind="os", threshold_db=6.0)
    fast = cells(build_cfar(config, ROWS, COLUMNS, 3).detect(power))
    assert fast == set(os_hits(power.astype(float), config, 3))
    assert fast


@settings(deadline=None, max_examples=25)
@given(hnp.arrays(np.int64, (9, 12), elements=st.integers(1, 10**6)), st.sampled_from(["ca", "os"]))
def test_any_map_agrees_with_plain_loops(counts: np.ndarray, kind: str) -> None:
    power = counts.astype(np.float32)
    config = CfarConfig(kind=kind, threshold_db=3.0, guard_range=1, guard_doppler=1, train_range=2, train_doppler=2)
    plain = cfar_hits if kind == "ca" else os_hits
    fast = cells(build_cfar(config, 9, 12, 1).detect(power))
    for row, column in fast ^ set(plain(power.astype(float), config, 1)):
        nudged = [
            plain(power.astype(float) * np.where(_is(power, row, column), f, 1.0), config, 1) for f in (0.999, 1.001)
        ]
        assert ((row, column) in nudged[0]) != ((row, column) in nudged[1])  # on the threshold, to rounding


def _is(power: np.ndarray, row: int, column: int) -> np.ndarray:
    mask = np.zeros(power.shape, bool)
    mask[row, column] = True
    return mask


@pytest.mark.parametrize("kind", ["ca", "os"])
def test_range_does_not_wrap_and_doppler_does(kind: str) -> None:
    power = np.ones((ROWS, COLUMNS), np.float32)
    power[ROWS - 4 :] = 1000.0  # loud far end
    power[2, 0] = 60.0
    config = CfarConfig(kind=kind, excise_db=0.0)
    assert (2, 0) in cells(build_cfar(config, ROWS, COLUMNS, 3).detect(power))
    power = np.ones((ROWS, COLUMNS), np.float32)
    power[:, -8:] = 1000.0  # loud just beyond the Doppler edge
    power[2, 0] = 60.0
    assert (2, 0) not in cells(build_cfar(config, ROWS, COLUMNS, 3).detect(power))


@pytest.mark.parametrize("kind", ["ca", "os"])
@pytest.mark.parametrize("row", [0, 1, ROWS // 2, ROWS - 1])
@pytest.mark.parametrize("column", [0, COLUMNS // 2, COLUMNS - 1])
def test_threshold_is_sixteen_db_over_mean_noise_power(kind: str, row: int, column: int) -> None:
    """Everywhere, edges too: 15 dB over flat noise is none, 17 dB is one."""
    flat = np.full((ROWS, COLUMNS), 5.0, np.float32)
    ratio = os_mean_ratio(129, 172, 3) if kind == "os" else 1.0  # a flat map is its own order statistic
    for over_db, expected in ((15.0, 0), (17.0, 1)):
        power = flat.copy()
        power[row, column] *= 10 ** (over_db / 10) / ratio
        assert len(build_cfar(CfarConfig(kind=kind), ROWS, COLUMNS, 3).detect(power).row) == expected


def test_a_small_map_uses_each_cell_once() -> None:
    """Eight chirps are fewer than guard and training cells: the zone is cut, no cell counts twice."""
    config = CfarConfig(threshold_db=6.0)
    zone = build_cfar(config, 25, 8, 3)._zone
    rows, columns = zone.offsets()
    assert len({(r, c % 8) for r, c in zip(rows.tolist(), columns.tolist(), strict=True)}) == len(rows)
    assert zone.sums(np.ones((25, 8), np.float32))[12, 4] == len(rows)


def test_a_wide_body_does_not_hide_itself() -> None:
    power = noise_map(5, 54, 64)
    power[3:9, 20:30] *= np.float32(1000.0)
    hidden = build_cfar(CfarConfig(excise_db=0.0), 54, 64, 3).detect(power)
    seen = build_cfar(CfarConfig(), 54, 64, 3).detect(power)
    assert len(seen.row) > 50 > len(hidden.row)


def test_a_second_target_in_the_training_zone_hides_nothing_from_the_ordered_statistic() -> None:
    power = np.ones((ROWS, COLUMNS), np.float32)
    power[10, 10], power[10, 15] = 60.0, 1e5
    assert (10, 10) not in cells(build_cfar(CfarConfig(excise_db=0.0), ROWS, COLUMNS, 3).detect(power))
    assert (10, 10) in cells(build_cfar(CfarConfig(kind="os"), ROWS, COLUMNS, 3).detect(power))


# --- theory ---------------------------------------------------------------------------------------------------


@given(st.floats(1e-6, 1e-1), st.integers(10, 400))
def test_one_look_has_the_closed_form(p_fa: float, count: int) -> None:
    assert ca_scale(p_fa, count) == pytest.approx(count * (p_fa ** (-1 / count) - 1), rel=1e-6)


def test_ordered_statistic_of_one_look_has_the_product_form() -> None:
    rank, count, scale = 129, 172, 6.0
    product = np.prod([(count - i) / (count - i + scale) for i in range(rank)])
    assert os_p_fa(scale, rank, count) == pytest.approx(product, rel=1e-3)


@given(st.sampled_from([1e-2, 1e-3, 1e-5]), st.sampled_from([1, 2, 3]))
def test_scale_and_probability_are_inverse(p_fa: float, looks: int) -> None:
    assert os_p_fa(os_scale(p_fa, 129, 172, looks), 129, 172, looks) == pytest.approx(p_fa, rel=1e-2)


@pytest.mark.parametrize("kind", ["ca", "os"])
@pytest.mark.parametrize("receivers", [1, 3])
@pytest.mark.parametrize(("p_fa", "frames"), [(1e-2, 30), (1e-3, 80), (1e-4, 150)])
def test_false_alarms_on_white_noise_are_as_rare_as_set(kind: str, receivers: int, p_fa: float, frames: int) -> None:
    rate = false_alarm_rate(p_fa, kind, receivers, frames, seed=11)
    assert rate.low <= p_fa <= rate.high


@pytest.mark.parametrize("kind", ["ca", "os"])
@pytest.mark.parametrize("receivers", [1, 3])
def test_false_alarms_at_one_in_a_hundred_thousand(kind: str, receivers: int) -> None:
    rate = false_alarm_rate(1e-5, kind, receivers, 600, seed=12)
    assert rate.low <= 1e-5 <= rate.high


@pytest.mark.parametrize("kind", ["ca", "os"])
@pytest.mark.parametrize("snr_db", [8.0, 15.0, 16.0, 17.0, 18.0, 25.0])
def test_detection_probability_agrees_with_marcum(kind: str, snr_db: float) -> None:
    trials = 240
    expected = detection_theory(snr_db, 16.0, 3)
    tolerance = 3.5 * np.sqrt(expected * (1 - expected) / trials) + 0.04  # and the loss of an estimated noise level
    assert detection_rate(snr_db, trials, seed=13, kind=kind) == pytest.approx(expected, abs=tolerance)


# --- noise floor ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("looks", [1, 3])
def test_the_noise_floor_does_not_see_bodies(looks: int) -> None:
    power = 40.0 * noise_map(6, 54, 64, looks)
    expected_db = 10 * np.log10(40.0)
    assert noise_floor_db(RowNoise(64, looks).estimate(power)) == pytest.approx(expected_db, abs=0.2)
    power[5:15, 10:30] *= np.float32(1e4)
    assert noise_floor_db(RowNoise(64, looks).estimate(power)) == pytest.approx(expected_db, abs=0.4)
