// The actuator's side of the gate: frames in, permission out. No Arduino in here, so that it can be tested on a desk.
// The same logic stands in ../micropython/gate_receiver.py; the tests hold both against each other.
// The frames: services/jetson/gate/frames.py.
#pragma once
#include <stdint.h>

const uint8_t TOLD_STOP = 0x00, TOLD_SLOW = 0x55, TOLD_GO = 0xAA;
const uint8_t AS_TOLD = 0, NO_FRAME_YET = 1, FRAMES_STOPPED = 2, NOT_STEADY_YET = 3;

const uint8_t FRAME_SYNC = 0xA5, REPORT_SYNC = 0x5A, FRAME_VERSION = 1;
const uint8_t FRAME_BYTES = 12, REPORT_BYTES = 10;
const uint16_t MAX_EXPIRY_MS = 250;
const uint32_t STEADY_MS = 1000;  // of frames without a break before anything may move, after power-up and a break

// CRC-16/CCITT-FALSE.
inline uint16_t crc16(const uint8_t *data, uint8_t count) {
  uint16_t crc = 0xFFFF;
  for (uint8_t i = 0; i < count; i++) {
    crc ^= (uint16_t)data[i] << 8;
    for (uint8_t bit = 0; bit < 8; bit++) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  }
  return crc;
}

// Feed every byte, call tick often, then do what permission and limit_mm_s say.
// Times are milliseconds as millis() gives them: they wrap, and only differences are used.
class GateReceiver {
 public:
  uint8_t permission = TOLD_STOP;
  uint16_t limit_mm_s = 0;
  uint8_t why = NO_FRAME_YET;
  uint8_t seq = 0;
  uint8_t refused = 0;

  // Take one byte; true when it completed a frame that was accepted.
  bool feed(uint8_t byte, uint32_t now_ms) {
    buffer_[length_++] = byte;
    if (buffer_[0] != FRAME_SYNC) {
      length_ = 0;
      return false;
    }
    if (length_ < FRAME_BYTES) return false;
    if (accept(now_ms)) {
      length_ = 0;
      return true;
    }
    refused++;
    resynchronise();
    return false;
  }

  // Stop when the last frame has expired.
  void tick(uint32_t now_ms) {
    if (alive_ && now_ms - arrived_ms_ > expiry_ms_) {
      alive_ = false;
      stop(FRAMES_STOPPED);
    }
  }

  // The ten bytes that tell the gate what is done.
  void report(uint8_t presses, uint8_t *out) const {
    const uint8_t body[8] = {REPORT_SYNC, FRAME_VERSION, seq, permission, why, presses, refused, 0};
    for (uint8_t i = 0; i < 8; i++) out[i] = body[i];
    const uint16_t crc = crc16(out, 8);
    out[8] = crc & 0xFF;
    out[9] = crc >> 8;
  }

 private:
  uint8_t buffer_[FRAME_BYTES];
  uint8_t length_ = 0;
  bool alive_ = false;  // frames are coming
  uint32_t arrived_ms_ = 0, steady_since_ms_ = 0;
  uint16_t expiry_ms_ = 0;

  bool accept(uint32_t now_ms) {
    const uint8_t *frame = buffer_;
    if (frame[1] != FRAME_VERSION || crc16(frame, 10) != (frame[10] | (uint16_t)frame[11] << 8)) return false;
    const uint8_t told = frame[3];
    const uint16_t expiry_ms = frame[6] | (uint16_t)frame[7] << 8;
    if ((told != TOLD_STOP && told != TOLD_SLOW && told != TOLD_GO) || expiry_ms > MAX_EXPIRY_MS) return false;
    tick(now_ms);
    const uint8_t ahead = frame[2] - seq;
    // A repetition, or one that was overtaken: it must not prolong anything.
    if (alive_ && told != TOLD_STOP && !(ahead >= 1 && ahead <= 127)) return false;
    if (!alive_) {
      alive_ = true;
      steady_since_ms_ = now_ms;
    }
    seq = frame[2];
    arrived_ms_ = now_ms;
    expiry_ms_ = expiry_ms;
    if (told != TOLD_STOP && now_ms - steady_since_ms_ < STEADY_MS) {
      stop(NOT_STEADY_YET);
    } else if (told == TOLD_STOP) {
      stop(AS_TOLD);
    } else {
      permission = told;
      limit_mm_s = frame[4] | (uint16_t)frame[5] << 8;
      why = AS_TOLD;
    }
    return true;
  }

  void stop(uint8_t reason) {
    permission = TOLD_STOP;
    limit_mm_s = 0;
    why = reason;
  }

  // Look for the next frame's beginning in what was taken for a frame.
  void resynchronise() {
    uint8_t at = 1;
    while (at < length_ && buffer_[at] != FRAME_SYNC) at++;
    for (uint8_t i = at; i < length_; i++) buffer_[i - at] = buffer_[i];
    length_ -= at;
  }
};
