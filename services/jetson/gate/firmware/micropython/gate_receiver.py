"""The actuator's side of the gate: frames in, permission out. Runs on MicroPython and on CPython alike, no I/O.

The same logic stands in ``../gate_uno_r4/gate_receiver.h`` for the Arduino; the tests hold both against each other.
Times are milliseconds as ``time.ticks_ms`` gives them: they wrap at 2**30, and only differences are used.
"""

STOP, SLOW, GO = 0x00, 0x55, 0xAA
AS_TOLD, NO_FRAME_YET, FRAMES_STOPPED, NOT_STEADY_YET = 0, 1, 2, 3

SYNC, REPORT_SYNC, VERSION = 0xA5, 0x5A, 1
FRAME_BYTES = 12
MAX_EXPIRY_MS = 250
STEADY_MS = 1000  # of frames without a break before anything may move, after power-up and after a break
TICKS_MASK = 0x3FFFFFFF


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


class GateReceiver:
    """``feed`` every byte, call ``tick`` often, then do what ``permission`` and ``limit_mm_s`` say."""

    def __init__(self) -> None:
        self.permission = STOP
        self.limit_mm_s = 0
        self.why = NO_FRAME_YET
        self.seq = 0
        self.refused = 0
        self._buffer = bytearray()
        self._alive = False  # frames are coming
        self._arrived_ms = 0
        self._expiry_ms = 0
        self._steady_since_ms = 0

    def feed(self, byte: int, now_ms: int) -> bool:
        """Take one byte; True when it completed a frame that was accepted."""
        self._buffer.append(byte)
        if self._buffer[0] != SYNC:
            self._buffer = self._buffer[1:]
            return False
        if len(self._buffer) < FRAME_BYTES:
            return False
        if self._accept(now_ms):
            self._buffer = bytearray()
            return True
        self.refused = (self.refused + 1) & 0xFF
        self._resynchronise()
        return False

    def tick(self, now_ms: int) -> None:
        """Stop when the last frame has expired."""
        if self._alive and _since(now_ms, self._arrived_ms) > self._expiry_ms:
            self._alive = False
            self._stop(FRAMES_STOPPED)

    def report(self, presses: int) -> bytes:
        """The ten bytes that tell the gate what is done."""
        body = bytes((REPORT_SYNC, VERSION, self.seq, self.permission, self.why, presses & 0xFF, self.refused, 0))
        crc = crc16(body)
        return body + bytes((crc & 0xFF, crc >> 8))

    def _accept(self, now_ms: int) -> bool:
        frame = self._buffer
        if frame[1] != VERSION or crc16(bytes(frame[:10])) != frame[10] | frame[11] << 8:
            return False
        ordered, expiry_ms = frame[3], frame[6] | frame[7] << 8
        if ordered not in (STOP, SLOW, GO) or expiry_ms > MAX_EXPIRY_MS:
            return False
        self.tick(now_ms)
        ahead = (frame[2] - self.seq) & 0xFF
        if self._alive and ordered != STOP and not 1 <= ahead <= 127:
            return False  # a repetition, or one that was overtaken: it must not prolong anything
        if not self._alive:
            self._alive, self._steady_since_ms = True, now_ms
        self.seq, self._arrived_ms, self._expiry_ms = frame[2], now_ms, expiry_ms
        if ordered != STOP and _since(now_ms, self._steady_since_ms) < STEADY_MS:
            self._stop(NOT_STEADY_YET)
        elif ordered == STOP:
            self._stop(AS_TOLD)
        else:
            self.permission, self.limit_mm_s, self.why = ordered, frame[4] | frame[5] << 8, AS_TOLD
        return True

    def _stop(self, why: int) -> None:
        self.permission, self.limit_mm_s, self.why = STOP, 0, why

    def _resynchronise(self) -> None:
        """Look for the next frame's beginning in what was taken for a frame."""
        rest = self._buffer[1:]
        at = rest.find(bytes((SYNC,)))
        self._buffer = rest[at:] if at >= 0 else bytearray()


def _since(now_ms: int, then_ms: int) -> int:
    return (now_ms - then_ms) & TICKS_MASK
