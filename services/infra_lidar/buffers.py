"""Reused memory: a frame allocates nothing once the largest frame has been seen."""

from __future__ import annotations

from typing import Any

import numpy as np

LINE_BYTES = 64  # a cache line, and the widest vector: one that crosses a line is loaded twice
LINE_FLOATS = LINE_BYTES // 4


def aligned(length: int, dtype: Any) -> np.ndarray:
    """An uninitialised (length,) array of ``dtype`` that begins at a cache line."""
    wanted = length * np.dtype(dtype).itemsize
    raw = np.empty(wanted + LINE_BYTES, np.uint8)
    first = -raw.ctypes.data % LINE_BYTES
    return raw[first : first + wanted].view(dtype)


_NOTHING = (np.empty(0), -1, None)


class Buffers:
    """Named arrays that grow to the largest size asked for. A view is valid until the same name is taken again."""

    def __init__(self) -> None:
        self._arrays: dict[str, tuple[np.ndarray, int, Any]] = {}  # what it is called: array, room, dtype as asked for

    def take(self, name: str, length: int, dtype: Any) -> np.ndarray:
        """An uninitialised (length,) array of ``dtype``; behind its end there is room for one more vector."""
        array, room, held = self._arrays.get(name, _NOTHING)
        if room < length or held is not dtype:
            room = length + length // 32
            array = aligned(room + LINE_FLOATS, dtype)
            self._arrays[name] = array, room, dtype
        return array[:length]

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(array.nbytes for array, _, _ in self._arrays.values())
