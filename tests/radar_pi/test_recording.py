"""The documented .radar file and the recorder's folder: round trip, and every way in which they can be broken."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.radar_pi.config import WaveformConfig
from services.radar_pi.parser import RecordingError, read_header, write_frame, write_header
from services.radar_pi.recording import Recorder, open_recording

WAVEFORM = WaveformConfig(chirps=4, samples=16, rx_mask=5)
RECORDER_SETTINGS = {
    "aaf_cutoff_Hz": 500000, "chirp_repetition_time_s": 0.0005911249900236726, "end_frequency_Hz": 63500000000,
    "frame_repetition_time_s": 0.07726884633302689, "hp_cutoff_Hz": 80000, "if_gain_dB": 23, "mimo_mode": "off",
    "num_chirps_per_frame": 8, "num_samples_per_chirp": 64, "rx_antennas": [1, 2, 3], "sample_rate_Hz": 2000000,
    "start_frequency_Hz": 58000000000, "tx_antennas": [1], "tx_power_level": 31,
}  # fmt: skip


def frames(count: int, shape: tuple[int, ...] = (2, 4, 16)) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 4096, (count, *shape)).astype(np.uint16)


def write_file(path: Path, count: int = 5) -> np.ndarray:
    samples = frames(count)
    with Recorder(path, WAVEFORM) as recorder:
        for i, frame in enumerate(samples):
            recorder.write(1000 + i, 2000 + i, frame)
    return samples


def write_folder(path: Path, settings: dict[str, object] | None = None, samples: np.ndarray | None = None) -> None:
    path.mkdir()
    shape = {"device_config": {"fmcw_single_shape": settings or RECORDER_SETTINGS}}
    (path / "config.json").write_text(json.dumps(shape))
    np.save(path / "radar.npy", frames(3, (3, 8, 64)) if samples is None else samples)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    samples = write_file(tmp_path / "a.radar")
    recording = open_recording(tmp_path / "a.radar")
    assert recording.waveform == WAVEFORM
    assert recording.stamps_ns.tolist() == [1000, 1001, 1002, 1003, 1004]
    assert np.array_equal(recording.frames, samples)
    assert [stamp_ns for stamp_ns, _ in recording] == recording.stamps_ns.tolist()


def test_the_layout_is_the_documented_one(tmp_path: Path) -> None:
    """Read with struct alone, as somebody without our code would."""
    samples = write_file(tmp_path / "a.radar", 2)
    data = (tmp_path / "a.radar").read_bytes()
    magic, version, length = struct.unpack_from("<8sII", data)
    assert (magic, version) == (b"SPOTRADR", 1)
    header = json.loads(data[16 : 16 + length])
    assert header["waveform"]["samples"] == 16
    frame_bytes = 16 + 2 * 4 * 16 * 2
    assert len(data) == 16 + length + 2 * frame_bytes
    stamp_ns, received_ns = struct.unpack_from("<qq", data, 16 + length + frame_bytes)
    assert (stamp_ns, received_ns) == (1001, 2001)
    values = np.frombuffer(data, "<u2", 128, 16 + length + frame_bytes + 16).reshape(2, 4, 16)
    assert np.array_equal(values, samples[1])


def test_an_incomplete_last_frame_is_left_out(tmp_path: Path) -> None:
    write_file(tmp_path / "a.radar", 3)
    data = (tmp_path / "a.radar").read_bytes()
    (tmp_path / "b.radar").write_bytes(data[:-7])
    assert len(open_recording(tmp_path / "b.radar").frames) == 2


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda data: b"RIFF" + data[4:], "does not begin with SPOTRADR"),
        (lambda data: data[:10], "does not begin with SPOTRADR"),
        (lambda data: data[:8] + struct.pack("<I", 9) + data[12:], "version 9, expected 1"),
        (lambda data: data[:12] + struct.pack("<I", 10**9) + data[16:], "is incomplete"),
        (lambda data: data[:40], "is incomplete"),
        (lambda data: data.replace(b'"samples": 16', b'"samples": -1'), "without a valid waveform"),
        (lambda data: data[: 16 + struct.unpack_from("<I", data, 12)[0] + 5], "no complete frame"),
    ],
)
def test_a_broken_file_is_refused_with_its_reason(
    tmp_path: Path, spoil: Callable[[bytes], bytes], expected: str
) -> None:
    write_file(tmp_path / "a.radar")
    (tmp_path / "b.radar").write_bytes(spoil((tmp_path / "a.radar").read_bytes()))
    with pytest.raises(RecordingError, match=expected):
        open_recording(tmp_path / "b.radar")


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(tail: bytes) -> None:
    for data in (tail, b"SPOTRADR" + tail, write_header(WAVEFORM)[: len(tail)] + tail):
        try:
            read_header(data)
        except RecordingError:
            continue


def test_the_recorders_folder_is_read(tmp_path: Path) -> None:
    write_folder(tmp_path / "r")
    recording = open_recording(tmp_path / "r")
    assert recording.waveform.chirps == 8
    assert recording.waveform.rx == (1, 2, 3)
    assert recording.waveform.end_frequency_hz == 63.5e9
    assert recording.frames.shape == (3, 3, 8, 64)
    assert np.diff(recording.stamps_ns).tolist() == pytest.approx([77268846, 77268846], abs=1)


@pytest.mark.parametrize(
    ("settings", "samples", "expected"),
    [
        ({"rx_antennas": [1, 3]}, None, "expected"),
        ({"num_samples_per_chirp": 3}, None, "settings"),
        (None, np.zeros((3, 3, 8, 64), np.float32), "unsigned"),
        (None, np.zeros((3, 8, 64), np.uint16), "expected"),
        (None, np.zeros((0, 3, 8, 64), np.uint16), "holds no frame"),
    ],
)
def test_a_folder_that_contradicts_itself_is_refused(
    tmp_path: Path, settings: dict[str, object] | None, samples: np.ndarray | None, expected: str
) -> None:
    write_folder(tmp_path / "r", RECORDER_SETTINGS | (settings or {}), samples)
    with pytest.raises(RecordingError, match=expected):
        open_recording(tmp_path / "r")


def test_an_archive_in_place_of_the_array_is_refused(tmp_path: Path) -> None:
    write_folder(tmp_path / "r")
    with (tmp_path / "r" / "radar.npy").open("wb") as file:
        np.savez(file, frames(3, (3, 8, 64)))
    with pytest.raises(RecordingError, match="an archive of several arrays"):
        open_recording(tmp_path / "r")


def test_pickles_are_not_loaded(tmp_path: Path) -> None:
    write_folder(tmp_path / "r")
    np.save(tmp_path / "r" / "radar.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(RecordingError):
        open_recording(tmp_path / "r")


@pytest.mark.parametrize("missing", ["radar.npy", "config.json"])
def test_a_missing_half_is_named(tmp_path: Path, missing: str) -> None:
    write_folder(tmp_path / "r")
    (tmp_path / "r" / missing).unlink()
    with pytest.raises(RecordingError, match=missing.split(".")[0]):
        open_recording(tmp_path / "r")


def test_frames_are_little_endian_whatever_they_were(tmp_path: Path) -> None:
    frame = frames(1)[0]
    assert write_frame(1, 2, frame.astype(">u2")) == write_frame(1, 2, frame)
