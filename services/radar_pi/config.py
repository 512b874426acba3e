"""Configuration of the radar service: every key with its unit, default and limits.

``radar.toml`` beside this file lists the same keys with comments. Axes (range bin, speed limit ...) are derived from
``[waveform]`` in ``axes.py`` and nowhere else.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from common.config import Section, ServiceConfig
from common.path import Mount, PathConfig

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Probability = Annotated[float, Meta(gt=0.0, lt=1.0)]


class WaveformConfig(Section, frozen=True, kw_only=True):
    """What the chip is told to send. The default sees walkers and a small car from 0.3 m to 6 m at up to 5 m/s."""

    # The synthesiser reaches 57.0 to 64.0 GHz; the data sheet specifies 58.0 to 63.5 GHz.
    start_frequency_hz: Annotated[float, Meta(ge=57.0e9, le=64.0e9)] = 60.0e9  # when the transmitter turns on
    end_frequency_hz: Annotated[float, Meta(ge=57.0e9, le=64.0e9)] = 61.31e9  # when the ramp ends
    samples: Annotated[int, Meta(ge=16, le=4095)] = 128  # per chirp and receiver
    chirps: Annotated[int, Meta(ge=2, le=4096)] = 64  # per frame
    sample_rate_hz: Annotated[float, Meta(ge=78.0e3, le=4.0e6)] = 1.25e6
    chirp_period_s: Annotated[float, Meta(gt=0.0, le=0.1)] = 0.24e-3
    frame_period_s: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.1
    rx_mask: Annotated[int, Meta(ge=1, le=7)] = 7  # bit 0 = RX1, bit 1 = RX2, bit 2 = RX3
    tx_power_level: Annotated[int, Meta(ge=0, le=31)] = 31
    if_gain_db: Annotated[int, Meta(ge=18, le=60)] = 33
    hp_cutoff_hz: Annotated[int, Meta(ge=20_000, le=80_000)] = 20_000  # 20, 45, 70 or 80 kHz
    lp_cutoff_hz: Annotated[int, Meta(ge=100_000, le=1_000_000)] = 500_000
    sample_delay_s: NotNegative = 3.1125e-6  # T_SSTART: transmitter on to first sample, not part of the sampled sweep
    register_file: str = ""  # Infineon register export ("NAME 0xADDR 0xVALUE"); replaces the computed list
    settings_file: str = ""  # Infineon settings JSON; replaces the keys above

    def __post_init__(self) -> None:
        if self.end_frequency_hz <= self.start_frequency_hz:
            raise ValueError("end_frequency_hz: the ramp has to rise above start_frequency_hz")
        if self.chirp_period_s <= self.samples / self.sample_rate_hz + self.sample_delay_s:
            raise ValueError("chirp_period_s: shorter than the time its samples take")
        if self.frame_period_s < self.chirps * self.chirp_period_s:
            raise ValueError("frame_period_s: shorter than its chirps take")

    @property
    def rx(self) -> tuple[int, ...]:
        """Active receivers by the chip's numbers (1, 2, 3), ascending: the order of the frame's first axis."""
        return tuple(n + 1 for n in range(3) if self.rx_mask >> n & 1)


class SpiConfig(Section, frozen=True, kw_only=True):
    """Wiring of the DreamHAT+ on a Raspberry Pi 5; used by ``spi:`` sources only."""

    bus: Annotated[int, Meta(ge=0)] = 0
    device: Annotated[int, Meta(ge=0)] = 0
    speed_hz: Annotated[int, Meta(ge=100_000, le=50_000_000)] = 50_000_000
    reset_gpio: int = 12  # active low
    irq_gpio: int = 25  # rising edge
    gpio_chip: str = "auto"  # the header's, by its label; or a path

    def __post_init__(self) -> None:
        if self.reset_gpio == self.irq_gpio:
            raise ValueError(f"reset_gpio and irq_gpio: both are {self.irq_gpio}, expected two lines")


class ProcessingConfig(Section, frozen=True, kw_only=True):
    """Windows and the clutter background."""

    window: Literal["hann", "hamming", "rectangular"] = "hann"  # both transforms
    mti: bool = True  # subtract the static background
    mti_memory: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.92  # weight of the old background; 0 = frame difference
    settling_frames: Annotated[int, Meta(ge=0, le=1000)] = 15
    range_offset_m: float = 0.0  # way through chip, antenna feed and cover, subtracted: shown minus taped range
    range_min_m: NotNegative = 0.2  # nearer is transmitter leakage
    range_max_m: Positive = 6.5  # farther is dropped: see "What it can and cannot see" in the README


class CfarConfig(Section, frozen=True, kw_only=True):
    """Constant false alarm rate detector over the range-Doppler power map (linear, never dB)."""

    kind: Literal["ca", "os"] = "ca"
    threshold_db: Annotated[float, Meta(ge=0.0, le=60.0)] = 16.0  # over the mean noise power of one cell
    p_fa: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0  # false alarm probability per cell; 0 = threshold_db counts
    guard_range: Annotated[int, Meta(ge=0, le=16)] = 2  # cells on each side
    guard_doppler: Annotated[int, Meta(ge=0, le=16)] = 3
    train_range: Annotated[int, Meta(ge=1, le=32)] = 6
    train_doppler: Annotated[int, Meta(ge=0, le=32)] = 4
    excise_db: NotNegative = 8.0  # ca: training cells so far above their range row's level are no noise; 0 = off
    os_fraction: Probability = 0.75  # rank of the ordered statistic among the training cells


class DetectionConfig(Section, frozen=True, kw_only=True):
    """Cells over threshold -> one detection per body."""

    body_range_m: Positive = 0.6  # a body spreads this far around its strongest cell
    body_velocity_mps: Positive = 2.2  # limbs swing this much faster or slower than the trunk
    body_azimuth_rad: Positive = 0.5
    part_db: NotNegative = 15.0  # the nearest part not weaker than this below the strongest gives the range
    moving_mps: Positive = 0.15  # slower peaks stand and never take a moving one
    vehicle_length_m: NotNegative = 3.0  # one behind the other, equally fast, in one direction: one vehicle
    vehicle_velocity_mps: Positive = 0.25
    vehicle_azimuth_rad: Positive = 0.2
    sidelobe_db: Positive = 40.0  # weaker by this in the row or column of a stronger cell: its sidelobe
    max_detections: Annotated[int, Meta(ge=1, le=500)] = 32  # the strongest are kept


class AzimuthConfig(Section, frozen=True, kw_only=True):
    """Angle from the phase difference of the horizontal receiver pair."""

    left_rx: Annotated[int, Meta(ge=1, le=3)] = 1  # as seen from the radar; swap them for a unit mounted upside down
    right_rx: Annotated[int, Meta(ge=1, le=3)] = 3
    spacing_m: Positive = 2.5e-3
    phase_offset_rad: float = 0.0  # measured on a boresight target, subtracted
    field_of_view_rad: Annotated[float, Meta(gt=0.0, le=1.58)] = 0.96  # farther off boresight is dropped
    upper_rx: Annotated[int, Meta(ge=1, le=3)] = 2  # above right_rx: tells how high an echo is
    upper_phase_offset_rad: float = 0.0  # as phase_offset_rad, for the upright pair

    def __post_init__(self) -> None:
        if self.left_rx == self.right_rx:
            raise ValueError(f"left_rx and right_rx: both are {self.left_rx}, expected two receivers")

    @property
    def upright(self) -> AzimuthConfig:
        """The upright pair: what is above counts as left."""
        return msgspec.structs.replace(self, left_rx=self.upper_rx, phase_offset_rad=self.upper_phase_offset_rad)


class TrackingConfig(Section, frozen=True, kw_only=True):
    """Kalman tracks in range, range rate and azimuth."""

    sigma_range_m: Positive = 0.12  # measurement noise, standard deviations
    sigma_velocity_mps: Positive = 0.15
    sigma_azimuth_rad: Positive = 0.09
    sigma_acceleration_mps2: Positive = 3.0  # process noise
    sigma_azimuth_rate_radps: Positive = 0.6
    gate: Positive = 16.3  # Mahalanobis distance squared: 99.9 % of chi-squared with 3 degrees of freedom
    confirm_frames: Annotated[int, Meta(ge=1, le=50)] = 3  # consecutive, the first detection counts
    delete_misses: Annotated[int, Meta(ge=1, le=50)] = 3
    approach_frames: Annotated[int, Meta(ge=1, le=50)] = 3
    moving_mps: Positive = 0.15  # slower is standing
    max_speed_mps: Positive = 6.0  # beyond v_max a speed is told from its alias by the range, up to this one
    alias_margin: NotNegative = 9.0  # so much less squared distance in all has the true one: 3 sigma
    alias_frames: Annotated[int, Meta(ge=1, le=100)] = 10  # undecided for so long: the speed as it was measured


class AlarmConfig(Section, frozen=True, kw_only=True):
    """Bands of an approach-confirmed track. All limits are inclusive."""

    imminent_ttc_s: Positive = 1.5
    imminent_range_m: Positive = 0.5
    caution_ttc_s: Positive = 3.0
    caution_range_m: Positive = 1.2
    flag_very_close: bool = True  # within imminent_range_m at near-zero velocity: CAUTION, however it came there


class MountingConfig(Section, frozen=True, kw_only=True):
    """Where the radar sits in the vehicle's frame (x forward, y left, from the origin of ``[path]``)."""

    x_m: Annotated[float, Meta(ge=-10.0, le=10.0)] = 0.20
    y_m: Annotated[float, Meta(ge=-10.0, le=10.0)] = 0.0
    yaw_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 0.0

    @property
    def mount(self) -> Mount:
        """Position in metres, direction in radians."""
        return Mount(self.x_m, self.y_m, math.radians(self.yaw_deg))


class PathAlarmConfig(Section, frozen=True, kw_only=True):
    """How tracks are held against the way ahead while the vehicle drives and its motion is known."""

    sigmas: Annotated[float, Meta(ge=0.0, le=5.0)] = 1.0  # of the track's uncertainty that widen the way
    widest_m: Positive = 0.5  # ... by this much at the most
    horizon_s: Annotated[float, Meta(ge=0.5, le=10.0)] = 4.0  # a contact later than this is none
    curve_lead_s: NotNegative = 0.3  # CAUTION so long before IMMINENT for what lies on the curve, not straight ahead
    way_frames: Annotated[int, Meta(ge=1, le=50)] = 3  # in a row decide whether a track meets the way
    speed_tolerance: Annotated[float, Meta(gt=0.0, le=0.5)] = 0.01  # standard deviation of the speedometer's error
    doppler_mps: Positive = 0.005  # standard deviation of a standing track's speed
    certain_sigmas: Annotated[float, Meta(ge=0.0, le=10.0)] = 2.5  # its speed shows it beside: no IMMINENT
    likely_sigmas: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.5  # so much less sure: no CAUTION either
    sideways_mps: Positive = 0.5  # standard deviation of a new track's speed across the line of sight
    sure_sigmas: Annotated[float, Meta(ge=0.0, le=5.0)] = 1.0  # less sure, what moves beside the way goes along it
    acceleration_mps2: Positive = 1.5  # of what moves, over ground
    cover_far_m: NotNegative = 6.0  # up to here a standing obstacle in the way is seen for certain
    cover_half_rad: Annotated[float, Meta(ge=0.0, le=1.58)] = (
        0.79  # and so far to either side: the antenna's 45 degrees
    )


class HealthConfig(Section, frozen=True, kw_only=True):
    """When the radar says that it cannot see."""

    learn_frames: Annotated[int, Meta(ge=2, le=10_000)] = 50  # after settling: noise floor and clutter are learned
    hold_frames: Annotated[int, Meta(ge=1, le=1000)] = 10  # a deviation has to last this long
    noise_db: Positive = 6.0  # limit: noise floor off its learned value
    clutter_db: Positive = 8.0  # limit: static clutter at the antenna off its learned value
    interference_db: Positive = 9.0  # limit: strong chirps of a frame above weak ones
    noise_floor_db: float | None = None  # a known noise floor, instead of learning it after every start
    leakage_db: float | None = None  # a known clutter at the antenna
    saturated_fraction: Probability = 0.01  # samples at the ADC's limits in one frame ...
    saturated_frames: Annotated[int, Meta(ge=1, le=1000)] = 30  # ... for so long; a near car does it for a moment


class OwnSpeedConfig(Section, frozen=True, kw_only=True):
    """The vehicle's own speed from standing echoes."""

    enabled: bool = True
    leakage_range_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 1.0  # nearer, the vehicle's own parts and leakage stand
    min_still_bins: Annotated[int, Meta(ge=1, le=200)] = 5  # range bins that keep their phase: the vehicle stands
    frames: Annotated[int, Meta(ge=1, le=20)] = 5  # whose detections are put together
    min_echoes: Annotated[int, Meta(ge=2, le=50)] = 4  # that agree
    min_share: Annotated[float, Meta(ge=0.1, le=1.0)] = 0.6  # of the echoes that have to agree
    min_spread_rad: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.35  # between the directions of those that agree
    tolerance_bins: Annotated[float, Meta(gt=0.0, le=10.0)] = 1.5  # of velocity
    acceleration_mps2: Annotated[float, Meta(ge=0.0, le=50.0)] = 2.0  # how far older frames may be wrong by now


class RadarConfig(ServiceConfig, frozen=True, kw_only=True):
    """Everything; ``RadarConfig()`` is the shipped default."""

    host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "pi0"
    source: str = ""
    ego_host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"  # whose ego/motion is this vehicle's
    waveform: WaveformConfig = msgspec.field(default_factory=WaveformConfig)
    spi: SpiConfig = msgspec.field(default_factory=SpiConfig)
    processing: ProcessingConfig = msgspec.field(default_factory=ProcessingConfig)
    cfar: CfarConfig = msgspec.field(default_factory=CfarConfig)
    detection: DetectionConfig = msgspec.field(default_factory=DetectionConfig)
    azimuth: AzimuthConfig = msgspec.field(default_factory=AzimuthConfig)
    tracking: TrackingConfig = msgspec.field(default_factory=TrackingConfig)
    alarm: AlarmConfig = msgspec.field(default_factory=AlarmConfig)
    mounting: MountingConfig = msgspec.field(default_factory=MountingConfig)
    path: PathConfig = msgspec.field(default_factory=PathConfig)
    on_path: PathAlarmConfig = msgspec.field(default_factory=PathAlarmConfig)
    health: HealthConfig = msgspec.field(default_factory=HealthConfig)
    own_speed: OwnSpeedConfig = msgspec.field(default_factory=OwnSpeedConfig)

    def check(self) -> None:
        """The range limits fit the waveform, where it is the one above and not that of a recording or of a file.

        Raises:
            ConfigError: they leave too few range bins.
        """
        from services.radar_pi.axes import derive_axes  # which needs the sections above

        of_a_recording = self.source.partition(":")[0] in ("file", "mcap")
        if not (of_a_recording or self.waveform.settings_file or self.waveform.register_file):
            derive_axes(self.waveform, self.processing)
