// The firmware on a desk. One command a line on stdin: "<ms> <throttle us> <button 0|1> <hex bytes or ->"; the answer is
// one line: "<enable> <led> <servo us> <permission> <limit> <why> <refused> <hex bytes sent or ->".
#include "Arduino.h"
// the sketch itself
#include "gate_uno_r4.ino"

int main() {
  setup();
  unsigned long ms;
  int throttle_us, button;
  char hex[4096];
  while (scanf("%lu %d %d %4095s", &ms, &throttle_us, &button, hex) == 4) {
    board::now_us = (uint32_t)(ms * 1000u) - (uint32_t)throttle_us;
    board::pins[RECEIVER] = HIGH;
    board::handler();
    board::now_us = (uint32_t)(ms * 1000u);
    board::pins[RECEIVER] = LOW;
    board::handler();
    board::pins[BUTTON] = button ? LOW : HIGH;
    for (const char *at = hex; at[0] != '-' && at[0] && at[1]; at += 2) {
      unsigned byte;
      sscanf(at, "%2x", &byte);
      Serial.in.push_back((uint8_t)byte);
    }
    loop();
    printf("%d %d %d %d %d %d %d ", board::pins[ENABLE], board::pins[LED_BUILTIN], throttle.us, gate.permission,
           gate.limit_mm_s, gate.why, gate.refused);
    if (Serial.out.empty()) printf("-");
    for (uint8_t byte : Serial.out) printf("%02x", byte);
    Serial.out.clear();
    printf("\n");
    fflush(stdout);
  }
  return board::watched ? 0 : 1;
}
