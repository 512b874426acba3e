"""One radar frame -> tracks with levels. No I/O, no clock: the same arrays give the same messages.

Raw chirps -> range FFT -> background subtraction -> Doppler FFT -> integration over receivers -> CFAR -> bodies ->
Kalman tracks -> alarm levels, and beside them the radar's own health.
"""

from __future__ import annotations

import math

import numpy as np

from common.messages import Cover, EgoMotion, Motion, RadarDetection, RadarDetections, RadarTrack, RadarTracks, worst
from common.stopwatch import Stopwatch
from services.radar_pi.alarm import alarm_level, approached_s_ago, is_moving, static_level, time_to_collision_s
from services.radar_pi.axes import derive_axes
from services.radar_pi.azimuth import PairAzimuth
from services.radar_pi.cfar import build_cfar
from services.radar_pi.clutter import Clutter
from services.radar_pi.config import RadarConfig
from services.radar_pi.detection import Detection, Measured, Peaks, find_peaks, group
from services.radar_pi.health import Health, HealthMonitor, Signals, chirp_spread_db, saturated_fraction
from services.radar_pi.noise import RowNoise, noise_floor_db
from services.radar_pi.own_speed import OwnMotion, OwnSpeed
from services.radar_pi.spectrum import RangeDoppler, mean_power
from services.radar_pi.tracking import Track, Tracker
from services.radar_pi.way import Way

FRAME_ID = "radar"
GAP_PERIODS = 5


class RadarPipeline:
    """All state of one radar: background, tracks, health."""

    def __init__(self, config: RadarConfig) -> None:
        self.config = config
        self.axes = axes = derive_axes(config.waveform, config.processing)
        receivers = config.waveform.rx
        processing = config.processing
        self.transform = RangeDoppler(config.waveform, processing.window, axes.far_bin)
        body_bins = math.ceil(config.detection.body_range_m / axes.range_bin_m)
        self.clutter = Clutter(processing.mti_memory, processing.settling_frames, body_bins, subtract=processing.mti)
        self.cfar = build_cfar(config.cfar, axes.far_bin - axes.near_bin, config.waveform.chirps, len(receivers))
        self.row_noise = RowNoise(config.waveform.chirps, len(receivers))
        self.azimuth = PairAzimuth(config.azimuth, receivers, axes.wavelength_m)
        self.elevation = PairAzimuth(config.azimuth.upright, receivers, axes.wavelength_m)
        self.tracker = Tracker(config.tracking, config.detection, axes.v_max_mps, axes.range_lead_s)
        self.way = Way(config)
        self.health = HealthMonitor(config.health)
        self.own_speed = OwnSpeed(config.own_speed, axes, config.waveform.frame_period_s)
        self.own_motion: OwnMotion | None = None
        self._stamp_ns: int | None = None
        self._epoch = 0
        self._power: np.ndarray | None = None
        self._detections: list[Detection] = []
        self._result: RadarTracks | None = None

    def process(
        self, stamp_ns: int, frame: np.ndarray, motion: Motion | None = None, epoch: int = 0, note: str = ""
    ) -> RadarTracks:
        """One frame of ADC samples to the tracks of that moment.

        Args:
            stamp_ns: UTC ns of the frame's first chirp.
            frame: (rx, chirp, sample) 12-bit ADC samples.
            motion: how the vehicle moves, None = unknown.
            epoch: rises whenever the chip was restarted; what was learned before is void then.
            note: what the driver says is wrong with the link although frames arrive.

        Raises:
            ValueError: the frame's shape is not the waveform's.
        """
        watch = Stopwatch()
        self._reset_after_restart(stamp_ns, epoch)
        # 1. window and range FFT: beat frequency is range
        profiles = self.transform.profiles(frame)
        # 2. moving target indication: take away what stands still
        moving = self.clutter.remove(profiles)
        # 3. window and Doppler FFT, then the mean power over the receivers
        spectrum = self.transform.doppler(moving)
        power = mean_power(spectrum)
        watch.lap("transform")
        # 4. cells above the noise around them, grouped to bodies with range, velocity and azimuth
        row_noise = self.row_noise.estimate(power[self.axes.near_bin :])
        detections = self._detect(power, row_noise, spectrum)
        if self.config.own_speed.enabled:
            self.own_motion = self.own_speed.update(profiles, detections)
        watch.lap("detect")
        # 5. tracks over time
        tracks = self.tracker.update(stamp_ns, detections)
        self.way.update(stamp_ns, self.tracker.tracks, motion)
        # 6. can the radar see at all?
        floor_db = noise_floor_db(row_noise)
        signals = Signals(
            saturated_fraction(frame), floor_db, self._leakage_db(), chirp_spread_db(moving[:, :, self.axes.near_bin :])
        )
        health = self.health.judge(self.clutter.settled, signals, note)
        # 7. what each track means
        self._power, self._detections = power, detections
        self._result = self._message(stamp_ns, tracks, motion, health, floor_db)
        watch.lap("track")
        self._result.stage_ms = watch.stage_ms
        return self._result

    def detections(self) -> RadarDetections:
        """Range-Doppler map and detections of the last frame, for people.

        Raises:
            RuntimeError: no frame has been processed yet.
        """
        if self._power is None or self._result is None:
            raise RuntimeError("no radar frame has been processed yet")
        return RadarDetections(
            stamp_ns=self._result.stamp_ns,
            frame_id=FRAME_ID,
            received_ns=self._result.received_ns,
            state=self._result.state,
            reason=self._result.reason,
            detections=[
                RadarDetection(
                    range_m=max(0.0, d.range_m), azimuth_rad=d.azimuth_rad, velocity_mps=d.velocity_mps, snr_db=d.snr_db
                )
                for d in self._detections
            ],
            range_doppler_db=10 * np.log10(np.maximum(self._power, 1e-12)),
            range_axis_m=self.axes.range_m[: self.axes.far_bin].astype(np.float32),
            velocity_axis_mps=self.axes.velocity_mps.astype(np.float32),
        )

    def motion(self) -> EgoMotion:
        """The vehicle's own speed by the last frame's standing echoes, unknown (None) when there were too few.

        Raises:
            RuntimeError: no frame has been processed yet.
        """
        if self._result is None:
            raise RuntimeError("no radar frame has been processed yet")
        own = self.own_motion
        return EgoMotion(
            stamp_ns=self._result.stamp_ns,
            frame_id=FRAME_ID,
            received_ns=self._result.received_ns,
            reason="" if own else "too few standing echoes",
            speed_mps=own.speed_mps if own else None,
            speed_sigma_mps=own.sigma_mps if own else None,
            yaw_rate_radps=None,
            speed_origin="radar" if own else "",
        )

    def _reset_after_restart(self, stamp_ns: int, epoch: int) -> None:
        """After a restart or a long gap the echo's phase has changed, and with it the background.

        Tracks live through a restart: a running alarm does not end because the chip was cured. A long gap ends them.
        """
        limit_ns = GAP_PERIODS * self.config.waveform.frame_period_s * 1e9
        gap = self._stamp_ns is not None and not 0 <= stamp_ns - self._stamp_ns <= limit_ns
        if gap or epoch != self._epoch:
            self.clutter.reset()
            self.own_speed.reset()
        if gap:
            self.tracker.tracks.clear()
        self._stamp_ns, self._epoch = stamp_ns, epoch

    def _detect(self, power: np.ndarray, row_noise: np.ndarray, spectrum: np.ndarray) -> list[Detection]:
        """CFAR, peaks, physical values, bodies."""
        axes, config = self.axes, self.config.detection
        hits = self.cfar.detect(power[axes.near_bin :], row_noise).shifted(axes.near_bin)
        peaks = find_peaks(power, hits, axes.near_bin, 4 * config.max_detections)
        velocity_mps = (peaks.column_exact - len(axes.velocity_mps) // 2) * axes.velocity_bin_mps
        gone = self._has_gone(peaks, velocity_mps)
        peaks, velocity_mps = peaks.take(~gone), velocity_mps[~gone]
        range_m = axes.to_range_m(peaks.row_exact, velocity_mps)
        azimuth_rad = self.azimuth.measure(spectrum, peaks.row, peaks.column)
        elevation_rad = self.elevation.measure(spectrum, peaks.row, peaks.column)
        measured = Measured(range_m, velocity_mps, azimuth_rad, elevation_rad)
        bodies = group(peaks, measured, axes.v_max_mps, config)
        limit_rad = self.config.azimuth.field_of_view_rad
        return [body for body in bodies if body.azimuth_rad is None or abs(body.azimuth_rad) <= limit_rad]

    def _has_gone(self, peaks: Peaks, velocity_mps: np.ndarray) -> np.ndarray:
        """(N,) bool: standing peaks where a standing echo has fallen: somebody who stood there has left."""
        standing = np.abs(velocity_mps) < self.config.detection.moving_mps
        fallen = self.clutter.fallen
        return standing if fallen is None else standing & fallen[peaks.row]

    def _leakage_db(self) -> float:
        """Static power in the bins nearer than anything that is looked at: transmitter leakage, window, cover."""
        background = self.clutter.background
        if background is None:
            return 0.0
        near = background[:, : self.axes.near_bin].ravel()
        return 10 * math.log10(max(float(np.vdot(near, near).real) / near.size, 1e-12))

    def _message(
        self, stamp_ns: int, tracks: list[Track], motion: Motion | None, health: Health, floor_db: float
    ) -> RadarTracks:
        speed_mps = motion.speed_mps if motion else None
        reports = [self._report(track, stamp_ns, speed_mps) for track in tracks]
        standing = [track for track in tracks if not is_moving(track, speed_mps, self.config.tracking)]
        static = self.way.static_level(standing) if self.way.driving else static_level(standing, self.config.alarm)
        return RadarTracks(
            stamp_ns=stamp_ns,
            frame_id=FRAME_ID,
            state=health.state,
            reason=health.reason,
            tracks=reports,
            level=worst(*(report.level for report in reports)),
            settled=self.clutter.settled,
            noise_floor_db=floor_db,
            static_level=static,
            v_max_mps=self.axes.v_max_mps,
            range_min_m=max(0.0, self.axes.range_min_m),
            range_max_m=self.axes.range_max_m,
            motion=motion,
            cover=self._cover(health),
        )

    def _cover(self, health: Health) -> Cover:
        """The antenna's cone; standing things show up while the vehicle drives towards them."""
        mount, on_path = self.config.mounting.mount, self.config.on_path
        sees = health.state == "online" and self.clutter.settled
        return Cover(
            x_m=mount.x_m,
            y_m=mount.y_m,
            first_rad=mount.yaw_rad - on_path.cover_half_rad,
            step_rad=2 * on_path.cover_half_rad,
            far_m=[min(on_path.cover_far_m, self.axes.range_max_m) if sees else 0.0],
            near_m=max(0.0, self.axes.range_min_m),
            standing=self.way.driving,
            why="" if sees else health.reason or "the clutter background is not learned yet",
        )

    def _report(self, track: Track, stamp_ns: int, speed_mps: float | None) -> RadarTrack:
        tracking = self.config.tracking
        ttc_s = time_to_collision_s(track, tracking)
        meeting = track.meeting
        if self.way.driving:
            level, ttc_s = self.way.level(track), meeting.likely.contact_s if meeting else None
        else:
            level = alarm_level(track, ttc_s, self.config.alarm, tracking.moving_mps)
        return RadarTrack(
            track_id=track.track_id,
            range_m=track.range_m,
            azimuth_rad=track.azimuth_rad,
            velocity_mps=track.velocity_mps,
            age_frames=track.age,
            approaching=track.approaching,
            moving=is_moving(track, speed_mps, tracking),
            ttc_s=ttc_s,
            level=level,
            snr_db=track.snr_db,
            coasting=track.misses > 0,
            approached_s_ago=approached_s_ago(track, stamp_ns),
            on_way=meeting.likely.on_way if meeting else None,
            beside_m=meeting.standing.beside_m(self.config.on_path.certain_sigmas) if meeting else None,
        )
