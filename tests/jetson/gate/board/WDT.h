#pragma once
#include "Arduino.h"
struct Watchdog {
  int begin(uint32_t) {
    board::watched = true;
    board::refreshed_us = board::now_us;
    return 1;
  }
  void refresh() { board::refreshed_us = board::now_us; }
};
inline Watchdog WDT;
