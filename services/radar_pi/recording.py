"""Files and folders of recorded chirps: open, write. The layout is ``parser.py``'s."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from services.radar_pi.chip.exports import read_settings
from services.radar_pi.config import WaveformConfig
from services.radar_pi.parser import (
    RecordingError,
    check_recorder_frames,
    frame_type,
    read_header,
    write_frame,
    write_header,
)

_HEADER_BYTES = 200_000


@dataclass(frozen=True)
class Recording:
    """Frames with their stamps, read from the disk as they are asked for."""

    waveform: WaveformConfig
    stamps_ns: np.ndarray  # (N,) int64; from zero where the recording has none
    frames: np.ndarray  # (N, rx, chirp, sample) unsigned

    def __iter__(self) -> Iterator[tuple[int, np.ndarray]]:
        for stamp_ns, frame in zip(self.stamps_ns, self.frames, strict=True):
            yield int(stamp_ns), np.asarray(frame)


def open_recording(path: Path) -> Recording:
    """A ``.radar`` file, or a folder with ``radar.npy`` and ``config.json``.

    Raises:
        RecordingError: nothing there, or not a recording.
    """
    try:
        return _open_folder(path) if path.is_dir() else _open_file(path)
    except OSError as error:
        raise RecordingError(f"{error.filename or path}: {error.strerror or error}") from None
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None


class Recorder:
    """Writes a ``.radar`` file, frame by frame. Use it in a ``with`` statement."""

    def __init__(self, path: Path, waveform: WaveformConfig) -> None:
        self._file = path.open("wb")
        self._file.write(write_header(waveform))

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()

    def write(self, stamp_ns: int, received_ns: int, frame: np.ndarray) -> None:
        """Append one frame: UTC ns of its start and of its reception, raw samples."""
        self._file.write(write_frame(stamp_ns, received_ns, frame))


def _open_file(path: Path) -> Recording:
    with path.open("rb") as file:
        waveform, offset = read_header(file.read(_HEADER_BYTES))
    record = frame_type(waveform)
    count = (path.stat().st_size - offset) // record.itemsize
    if count == 0:
        raise RecordingError("holds no complete frame")
    data = np.memmap(path, record, mode="r", offset=offset, shape=(count,))
    return Recording(waveform, np.asarray(data["stamp_ns"]), data["samples"])


def _open_folder(path: Path) -> Recording:
    try:
        waveform = read_settings(path / "config.json")
        frames = np.load(path / "radar.npy", mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise RecordingError(str(error)) from None
    check_recorder_frames(frames, waveform)
    stamps_ns = np.round(np.arange(len(frames)) * waveform.frame_period_s * 1e9).astype(np.int64)
    return Recording(waveform, stamps_ns, frames)
