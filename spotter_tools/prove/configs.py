"""The configuration of every service for a vehicle preset: what its owner would have measured and written down."""

from __future__ import annotations

from dataclasses import dataclass

from common.path import PathConfig
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.config import MountConfig as CameraMount
from services.jetson.fusion.config import FusionConfig, SensorsConfig
from services.jetson.gate.config import GateConfig, SpeedConfig
from services.jetson.lidar.config import LidarConfig, MountingSection, ZonesSection
from services.radar_pi.config import (
    MountingConfig,
    PathAlarmConfig,
    ProcessingConfig,
    RadarConfig,
    TrackingConfig,
    WaveformConfig,
)
from spotter_tools.prove.case import PRESETS, Preset

SENSORS = ("lidar", "radar", "camera")  # that take part


@dataclass(frozen=True)
class Configs:
    """One of each service that takes part."""

    lidar: LidarConfig
    radar: RadarConfig
    camera: CameraConfig
    fusion: FusionConfig
    gate: GateConfig


def configs_of(name: str) -> Configs:
    """For the preset of that name."""
    preset = PRESETS[name]
    gate = GateConfig(accept=("simulated",), speed=SpeedConfig(slow_mps=preset.slow_mps, go_mps=preset.go_mps))
    path = path_of(preset)
    fusion = FusionConfig(path=path, sensors=SensorsConfig().only(SENSORS))
    camera = CameraConfig(mount=CameraMount(height_m=float(preset.chassis.T_vehicle_camera[2, 3])), path=path)
    if name == "model":
        lidar = LidarConfig(mounting=MountingSection(front_m=_before_lidar_m(preset)), path=path)
        return Configs(lidar, RadarConfig(path=path), camera, fusion, gate)
    return Configs(_wide_lidar(preset, path), _far_radar(preset, path), camera, fusion, gate)


def path_of(preset: Preset) -> PathConfig:
    """True outline and brakes of the preset."""
    length_m, width_m, _ = preset.chassis.size_m
    return PathConfig(
        width_m=width_m,
        front_m=length_m / 2,
        rear_m=length_m / 2,
        wheelbase_m=preset.chassis.wheelbase_m,
        brake_mps2=preset.brake_mps2,
    )


def _before_lidar_m(preset: Preset) -> float:
    """How far the bumper is ahead of the lidar."""
    return round(0.5 * preset.chassis.size_m[0] - float(preset.chassis.T_vehicle_ld06[0, 3]), 3)


def _wide_lidar(preset: Preset, path: PathConfig) -> LidarConfig:
    """Lanes as wide as the vehicle; the lidar at the bumper sees nothing of the vehicle itself."""
    length, width, _ = preset.chassis.size_m
    mounting = MountingSection(front_m=_before_lidar_m(preset), vehicle_length_m=length, vehicle_width_m=width)
    zones = ZonesSection(centre_width_m=width + 0.06, side_width_m=0.3, fov_deg=80.0)
    return LidarConfig(mounting=mounting, zones=zones, path=path)


def _far_radar(preset: Preset, path: PathConfig) -> RadarConfig:
    """Half the bandwidth for twice the range, half the chirp period for twice the speed."""
    waveform = WaveformConfig(start_frequency_hz=60.0e9, end_frequency_hz=60.66e9, chirp_period_s=0.12e-3)
    return RadarConfig(
        waveform=waveform,
        processing=ProcessingConfig(range_max_m=12.5),
        tracking=TrackingConfig(max_speed_mps=9.0),
        mounting=MountingConfig(x_m=float(preset.chassis.T_vehicle_radar[0, 3])),
        path=path,
        on_path=PathAlarmConfig(cover_far_m=12.0),
    )
