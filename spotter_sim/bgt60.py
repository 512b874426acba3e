"""Raw chirps of a BGT60TR13C: the beat signal of every receiver, as the 12-bit ADC delivers it.

FMCW with an up-chirp (Richards, Fundamentals of Radar Signal Processing, 2nd ed., section 2.6; data sheet V2.4.9):
a target at R = R0 + v t beats with the phase 4 pi R (f0 + S tau) / c, tau within the chirp. A closing target's phase
falls from chirp to chirp: negative Doppler frequency in the positive half of the range spectrum.

Receivers: RX1 and RX3 2.5 mm apart on y, RX2 2.5 mm above RX3. A target at the left (positive azimuth) is farther from
RX3 than from RX1, so azimuth = asin(lambda (phase3 - phase1) / (2 pi 2.5 mm)); one above is nearer to RX2 than to RX3.

Within one frame a target keeps the range cell of mid-frame and the phase rate of mid-chirp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from common.geometry import invert, transform_points
from spotter_sim.model import DeviceUnplugged, Scenario, WorldState, noise_rng
from spotter_sim.solids import BOX, CYLINDER, KINDS, Solids
from spotter_sim.world import world_at

C_MPS = 299_792_458.0
RX_SPACING_M = 2.5e-3
MID_SCALE, FULL_SCALE = 2048, 4095
NOISE_LSB = 6.0
_FIELD_OF_VIEW_RAD = np.radians(75.0)
_WITHIN_M = 12.0
_FOOTPRINT = 0.4  # side of the patch that reflects, per metre of range: what is larger and near acts as a mirror
PATCH_M = 1.0
_LEAST_LSB = 0.02  # a fainter echo stays 10 dB below the noise after both transforms (64 chirps of 128 samples)
_MIRROR_RAD, _ROUGHNESS = np.radians(12.0), 0.35  # what is seen at a larger angle sends only its diffuse share back
_GROUND = KINDS.index("ground")
# Peak amplitude in ADC steps of a square metre of surface at 1 m, by solids.PARTS.
_ECHO_LSB = np.array([250.0, 120.0, 60.0, 700.0, 550.0, 150.0, 500.0, 700.0, 200.0, 60.0, 300.0, 150.0, 200.0])


@dataclass(frozen=True)
class Waveform:
    """The part of the chirp that is sampled; ``start_frequency_hz`` is the frequency at the first sample."""

    start_frequency_hz: float = 60.093e9
    sampled_bandwidth_hz: float = 1.27e9
    samples: int = 128
    chirps: int = 64
    sample_rate_hz: float = 1.25e6
    chirp_period_s: float = 0.24e-3
    rx: tuple[int, ...] = (1, 2, 3)  # active receivers, ascending
    hp_cutoff_hz: float = 20e3
    lp_cutoff_hz: float = 500e3

    @property
    def slope_hz_per_s(self) -> float:
        """Ramp slope: the sampled bandwidth over the time in which it is sampled."""
        return self.sampled_bandwidth_hz * self.sample_rate_hz / self.samples

    @property
    def wavelength_m(self) -> float:
        """At the middle of the sampled sweep."""
        return C_MPS / (self.start_frequency_hz + 0.5 * self.sampled_bandwidth_hz)


@dataclass(frozen=True)
class Target:
    """A point that reflects; ``amplitude_lsb`` is its peak in ADC steps at 1 m (it falls with the range squared)."""

    range_m: float
    velocity_mps: float = 0.0  # closing is negative
    azimuth_rad: float = 0.0  # left is positive
    amplitude_lsb: float = 300.0
    elevation_rad: float = 0.0


# What leaks from the transmitter into the receivers and the radome: strong, very near, static.
LEAKAGE = (Target(0.04, amplitude_lsb=8.0), Target(0.09, amplitude_lsb=9.0))


def simulate(
    targets: tuple[Target, ...] | list[Target], waveform: Waveform, noise_lsb: float = NOISE_LSB, seed: int = 0
) -> np.ndarray:
    """One frame of explicit targets.

    Returns:
        (rx, chirp, sample) uint16, 0..4095 about mid-scale 2048; clipped as the ADC clips.
    """
    rng = np.random.Generator(np.random.SFC64(seed))
    return _digitise(_beat(_table(targets), waveform), noise_lsb, rng)


def frame(name: str | Scenario, t_s: float, waveform: Waveform | None = None) -> np.ndarray:
    """The frame whose first chirp starts at ``t_s``: (rx, chirp, sample) uint16.

    Raises:
        DeviceUnplugged: fault ``radar_unplugged``.
        TimeoutError: fault ``radar_silent``: no frame arrives although the device answers.
    """
    world = world_at(name, t_s)
    if "radar_unplugged" in world.faults:
        raise DeviceUnplugged("simulated radar is unplugged")
    if "radar_silent" in world.faults:
        raise TimeoutError("simulated radar sends no frame")
    rng = noise_rng(world.scenario, world.t_s, "bgt60")
    echoes = np.vstack([_table(LEAKAGE), scatterers(world)])
    return _digitise(_beat(echoes, waveform or Waveform()), NOISE_LSB, rng)


def scatterers(world: WorldState) -> np.ndarray:
    """(T, 5) range, radial velocity, azimuth, elevation, amplitude at 1 m: one per solid in view, radar frame.

    From a vehicle that drives, what is long reflects from each of its patches: they come nearer at different speeds.
    """
    T_map_radar = world.T_map_vehicle @ world.chassis.T_vehicle_radar
    solids = world.solids_near(T_map_radar[:3, 3], _WITHIN_M, limbs=True)
    if not world.drives:
        rows = echoes(solids, T_map_radar)
    else:
        rows = driving_echoes(world, solids)
        rows = rows[rows[:, 4] > _LEAST_LSB * np.maximum(rows[:, 0], 0.1) ** 2]
    return rows[(np.abs(rows[:, 2]) < _FIELD_OF_VIEW_RAD) & (rows[:, 0] > 0.02)]


def driving_echoes(world: WorldState, solids: Solids) -> np.ndarray:
    """Echoes as ``echoes`` gives them, of all that stands too, seen from a radar that moves with the vehicle."""
    T_map_radar = world.T_map_vehicle @ world.chassis.T_vehicle_radar
    own_mps = world.vehicle.velocity_of(world.chassis.T_vehicle_radar)
    solids = patches(solids.take(solids.kind != _GROUND))  # a road at grazing incidence scatters away from us
    relative = replace(solids, velocity_mps=solids.velocity_mps - own_mps)
    rows = echoes(relative, T_map_radar)
    rows[:, 4] *= _facing(solids, T_map_radar[:3, 3])
    return rows


def patches(solids: Solids) -> Solids:
    """Long boxes cut across their longest level axis into pieces of at most a metre; all else as it is."""
    half = np.sqrt(np.sum(solids.from_unit[:, :2] ** 2, axis=1))
    count = np.where(solids.shape == BOX, np.ceil(2.0 * half.max(axis=1) / PATCH_M - 1e-6), 1.0).astype(int)
    if count.max(initial=1) == 1:
        return solids
    owner = np.repeat(np.arange(len(solids)), count)
    place = np.concatenate([(2.0 * np.arange(n) + 1.0) / n - 1.0 for n in count])  # along the axis, -1 to 1
    cut, axis, row = solids.take(owner), half.argmax(axis=1)[owner], np.arange(len(owner))
    from_unit = cut.from_unit.copy()
    along = from_unit[row, :, axis]
    from_unit[row, :, axis] = along / count[owner][:, None]
    return replace(cut, centre_m=cut.centre_m + place[:, None] * along, from_unit=from_unit)


def _facing(solids: Solids, origin_m: np.ndarray) -> np.ndarray:
    """(P,) 1 where a box reflects straight back as a mirror does; at an angle only what its roughness sends back.

    Diffuse share by Lambert's law: the squared cosine between the line of sight and the nearest face.
    """
    from_origin = origin_m - solids.centre_m
    u = np.einsum("pij,pj->pi", solids.to_unit, from_origin)
    outside = np.maximum(np.abs(u) - 1.0, 0.0) * np.sqrt(np.sum(solids.from_unit**2, axis=1))
    cosine = outside.max(axis=1) / np.maximum(np.linalg.norm(outside, axis=1), 1e-9)
    mirror = cosine > np.cos(_MIRROR_RAD)
    return np.where(solids.shape == BOX, np.where(mirror, 1.0, _ROUGHNESS * cosine**2), 1.0)


def echoes(solids: Solids, T_map_radar: np.ndarray) -> np.ndarray:
    """(P, 5) range, radial velocity, azimuth, elevation, amplitude at 1 m of every solid, radar frame."""
    point = transform_points(invert(T_map_radar), facing_point(solids, T_map_radar[:3, 3]))
    range_m = np.linalg.norm(point, axis=1)
    velocity = np.sum(solids.velocity_mps @ T_map_radar[:3, :3] * point, axis=1) / range_m
    azimuth, elevation = np.arctan2(point[:, 1], point[:, 0]), np.arcsin(point[:, 2] / range_m)
    half = np.sort(np.sqrt(np.sum(solids.from_unit**2, axis=1)), axis=1)
    side_m = np.minimum(2.0 * np.sqrt(half[:, 1] * half[:, 2]), 1.0)  # a flat wall reflects from one Fresnel zone only
    side_m = np.minimum(side_m, _FOOTPRINT * range_m)  # so near echoes grow with 1 / range, not with 1 / range^2
    pattern = np.cos(azimuth) ** 2 * np.cos(elevation) ** 2
    amplitude = _ECHO_LSB[solids.part] * side_m * pattern
    return np.column_stack([range_m, velocity, azimuth, elevation, amplitude])


def facing_point(solids: Solids, origin_m: np.ndarray) -> np.ndarray:
    """(P, 3) a point on each solid's surface that faces the radar: where it mainly reflects."""
    u = np.einsum("pij,pj->pi", solids.to_unit, origin_m - solids.centre_m)
    ball = u / np.maximum(np.linalg.norm(u, axis=1), 1.0)[:, None]
    drum = u / np.maximum(np.hypot(u[:, 0], u[:, 1]), 1.0)[:, None]
    drum[:, 2] = np.clip(u[:, 2], -1.0, 1.0)
    shape = solids.shape[:, None]
    u = np.where(shape == BOX, np.clip(u, -1.0, 1.0), np.where(shape == CYLINDER, drum, ball))
    return solids.centre_m + np.einsum("pij,pj->pi", solids.from_unit, u)


def _table(targets: tuple[Target, ...] | list[Target]) -> np.ndarray:
    rows = [(t.range_m, t.velocity_mps, t.azimuth_rad, t.elevation_rad, t.amplitude_lsb) for t in targets]
    return np.array(rows, float).reshape(-1, 5)


def _beat(echoes: np.ndarray, w: Waveform) -> np.ndarray:
    """(rx, chirp, sample) float32 beat signal in ADC steps: a sum of separable phasors, so one matrix product."""
    range_m, velocity, azimuth, elevation, strength = echoes.T
    chirp_s = np.arange(w.chirps) * w.chirp_period_s
    middle_m = range_m + velocity * chirp_s.mean()
    beat_hz = 2.0 * w.slope_hz_per_s * middle_m / C_MPS + 2.0 * velocity * w.start_frequency_hz / C_MPS
    high_pass = beat_hz / np.hypot(beat_hz, w.hp_cutoff_hz)
    low_pass = 1.0 / np.sqrt(1.0 + (beat_hz / w.lp_cutoff_hz) ** 8)
    amplitude = strength * high_pass * low_pass / np.maximum(range_m, 0.03) ** 2
    # (chirp, target): the phase at the first sample; what moves turns it at the frequency of mid-chirp
    slow = 4.0 * np.pi * (w.start_frequency_hz / C_MPS * range_m + velocity / w.wavelength_m * chirp_s[:, None])
    turn = 2.0 * np.pi * RX_SPACING_M / w.wavelength_m
    lag = {1: 0.0 * azimuth, 3: turn * np.sin(azimuth) * np.cos(elevation)}
    lag[2] = lag[3] - turn * np.sin(elevation)
    chirp_phase = np.stack([slow + lag[rx] for rx in w.rx]).reshape(len(w.rx) * w.chirps, len(echoes))
    sample_phase = 2.0 * np.pi * beat_hz[:, None] * np.arange(w.samples) / w.sample_rate_hz  # (target, sample)
    # cos(a + b) = cos a cos b - sin a sin b
    left = np.hstack([amplitude * np.cos(chirp_phase), -amplitude * np.sin(chirp_phase)]).astype(np.float32)
    right = np.vstack([np.cos(sample_phase), np.sin(sample_phase)]).astype(np.float32)
    return (left @ right).reshape(len(w.rx), w.chirps, w.samples)


def _digitise(signal: np.ndarray, noise_lsb: float, rng: np.random.Generator) -> np.ndarray:
    noise = noise_lsb * rng.standard_normal(signal.shape, np.float32)
    return np.clip(np.rint(MID_SCALE + signal + noise), 0, FULL_SCALE).astype(np.uint16)
