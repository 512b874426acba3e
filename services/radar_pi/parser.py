"""Bytes and JSON of recordings -> waveform and frames. No I/O.

Two kinds are read: Spotter's own ``.radar`` file and the folder that Infineon's recorder writes (``radar.npy`` and
``config.json``, whose settings ``exports.py`` reads).

The ``.radar`` file, all numbers little endian::

    offset 0   8 bytes   "SPOTRADR"
           8   uint32    version, 1
          12   uint32    length n of the header
          16   n bytes   UTF-8 JSON {"waveform": {...the keys of [waveform]...}}
    then per frame:
               int64     stamp_ns: UTC of the measurement
               int64     received_ns: UTC when the frame was complete
               uint16    rx * chirps * samples ADC values, receiver by receiver, chirp by chirp

A file whose writer died ends in an incomplete frame, which is left out.
"""

from __future__ import annotations

import json
import struct

import msgspec
import numpy as np

from services.radar_pi.config import WaveformConfig

MAGIC = b"SPOTRADR"
VERSION = 1
_PREFIX = struct.Struct("<8sII")
_MAX_HEADER = 100_000


class RecordingError(ValueError):
    """Not a radar recording, or one that contradicts itself; the text says what is wrong."""


def write_header(waveform: WaveformConfig) -> bytes:
    """The beginning of a ``.radar`` file."""
    header = json.dumps({"waveform": msgspec.to_builtins(waveform)}).encode()
    return _PREFIX.pack(MAGIC, VERSION, len(header)) + header


def write_frame(stamp_ns: int, received_ns: int, frame: np.ndarray) -> bytes:
    """One frame of a ``.radar`` file; ``frame`` is (rx, chirp, sample) uint16."""
    return struct.pack("<qq", stamp_ns, received_ns) + frame.astype("<u2").tobytes()


def read_header(start: bytes) -> tuple[WaveformConfig, int]:
    """Waveform and offset of the first frame, from the first bytes of a file.

    Raises:
        RecordingError: not such a file, cut short, another version, or no valid waveform.
    """
    if len(start) < _PREFIX.size or not start.startswith(MAGIC):
        raise RecordingError("not a .radar file: it does not begin with SPOTRADR")
    _, version, length = _PREFIX.unpack_from(start)
    if version != VERSION:
        raise RecordingError(f".radar file of version {version}, expected {VERSION}")
    end = _PREFIX.size + length
    if length > _MAX_HEADER or len(start) < end:
        raise RecordingError(f".radar file: header of {length} bytes is incomplete")
    try:
        header = json.loads(start[_PREFIX.size : end])
        return msgspec.convert(header["waveform"], WaveformConfig), end
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(f".radar file: header without a valid waveform: {error}") from None


def frame_type(waveform: WaveformConfig) -> np.dtype:
    """The numpy record of one frame: stamp_ns, received_ns, samples (rx, chirp, sample)."""
    shape = (len(waveform.rx), waveform.chirps, waveform.samples)
    return np.dtype([("stamp_ns", "<i8"), ("received_ns", "<i8"), ("samples", "<u2", shape)])


def check_recorder_frames(frames: np.ndarray, waveform: WaveformConfig) -> None:
    """Raise ``RecordingError`` unless the array is (frames, rx, chirp, sample) unsigned, as its settings say."""
    if not isinstance(frames, np.ndarray):
        raise RecordingError("radar.npy: an archive of several arrays, expected one array")
    expected = (len(waveform.rx), waveform.chirps, waveform.samples)
    if frames.dtype.kind != "u" or frames.ndim != 4 or frames.shape[1:] != expected:
        raise RecordingError(
            f"radar.npy: {frames.shape} {frames.dtype}, expected (frames, rx, chirp, sample) = (N, {expected}) unsigned"
        )
    if len(frames) == 0:
        raise RecordingError("radar.npy: holds no frame")
