// As much of Arduino as the firmware uses, for a desk: pins are an array, time is set by the test.
#pragma once
#include <stdint.h>
#include <stdio.h>

#include <deque>
#include <vector>

const int LOW = 0, HIGH = 1, INPUT = 0, OUTPUT = 1, INPUT_PULLUP = 2, CHANGE = 1, LED_BUILTIN = 13;

namespace board {
inline uint32_t now_us = 0;
inline int pins[32] = {};
inline void (*handler)() = nullptr;
inline bool watched = false;
inline uint32_t refreshed_us = 0;
}  // namespace board

inline uint32_t micros() { return board::now_us; }
inline uint32_t millis() { return board::now_us / 1000; }
inline void digitalWrite(int pin, int value) { board::pins[pin] = value; }
inline int digitalRead(int pin) { return board::pins[pin]; }
inline void pinMode(int pin, int mode) {
  if (mode == INPUT_PULLUP) board::pins[pin] = HIGH;
}
inline int digitalPinToInterrupt(int pin) { return pin; }
inline void attachInterrupt(int, void (*handler)(), int) { board::handler = handler; }
inline void noInterrupts() {}
inline void interrupts() {}

struct SerialPort {
  std::deque<uint8_t> in;
  std::vector<uint8_t> out;
  void begin(long) {}
  int available() { return (int)in.size(); }
  int read() {
    const uint8_t byte = in.front();
    in.pop_front();
    return byte;
  }
  int availableForWrite() { return 64; }
  void write(const uint8_t *data, int count) { out.insert(out.end(), data, data + count); }
};
inline SerialPort Serial;
