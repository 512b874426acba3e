// The gate's actuator on an Arduino Uno R4 (Minima or WiFi). Open this folder in the Arduino IDE and upload.
//
//   USB        to the Jetson: serial:/dev/ttyACM0
//   D7 ENABLE  relay or ESC enable, high = may move. A resistor of 10 k to ground keeps it low while the board starts.
//   D9 THROTTLE  to the ESC; the radio receiver's throttle channel comes in on D2. Leave both open without an ESC.
//   D4 BUTTON  to ground: a person acknowledges.
//
// Set US_PER_MPS before the first drive (README, "Put it on a car").
#include <Servo.h>
#include <WDT.h>

#include "gate_receiver.h"

const uint8_t ENABLE = 7, THROTTLE = 9, RECEIVER = 2, BUTTON = 4;
const int NEUTRAL_US = 1500, MAX_US = 500;
const int US_PER_MPS = 60;  // measure it: how far from neutral the throttle is at 1 m/s, with the wheels on the ground
const uint32_t REPORT_EVERY_MS = 100, RECEIVER_LOST_MS = 100, DEBOUNCE_MS = 30, WATCHDOG_MS = 150;

GateReceiver gate;
Servo throttle;
volatile uint32_t rise_us = 0, pulse_us = NEUTRAL_US, pulse_ms = 0;
uint32_t reported_ms = 0, button_ms = 0;
uint8_t presses = 0, reported = TOLD_STOP;
bool was_down = false;

// The width of the radio receiver's throttle pulse.
void receiver_edge() {
  const uint32_t now_us = micros();
  if (digitalRead(RECEIVER)) {
    rise_us = now_us;
  } else if (now_us - rise_us >= 800 && now_us - rise_us <= 2200) {
    pulse_us = now_us - rise_us;
    pulse_ms = millis();
  }
}

// What the driver wants; neutral when the radio is silent.
int wanted_us(uint32_t now_ms) {
  noInterrupts();
  const int us = pulse_us;
  const uint32_t at_ms = pulse_ms;
  interrupts();
  return now_ms - at_ms < RECEIVER_LOST_MS ? us : NEUTRAL_US;
}

// What is allowed of it: neutral with STOP, else within the limit, reverse too.
int allowed_us(int us) {
  if (gate.permission == TOLD_STOP) return NEUTRAL_US;
  const long reach = (long)gate.limit_mm_s * US_PER_MPS / 1000;
  const int most = reach < MAX_US ? (int)reach : MAX_US;
  if (us > NEUTRAL_US + most) return NEUTRAL_US + most;
  if (us < NEUTRAL_US - most) return NEUTRAL_US - most;
  return us;
}

void count_presses(uint32_t now_ms) {
  const bool down = digitalRead(BUTTON) == LOW;
  if (down == was_down || now_ms - button_ms < DEBOUNCE_MS) return;
  was_down = down;
  button_ms = now_ms;
  if (down) presses++;
}

void setup() {
  digitalWrite(ENABLE, LOW);
  pinMode(ENABLE, OUTPUT);
  pinMode(LED_BUILTIN, OUTPUT);
  pinMode(BUTTON, INPUT_PULLUP);
  pinMode(RECEIVER, INPUT);
  throttle.attach(THROTTLE);
  throttle.writeMicroseconds(NEUTRAL_US);
  attachInterrupt(digitalPinToInterrupt(RECEIVER), receiver_edge, CHANGE);
  Serial.begin(115200);
  WDT.begin(WATCHDOG_MS);  // a board that hangs resets, and ENABLE is low
}

void loop() {
  WDT.refresh();
  bool accepted = false;
  while (Serial.available()) accepted = gate.feed(Serial.read(), millis()) || accepted;
  const uint32_t now_ms = millis();
  gate.tick(now_ms);
  digitalWrite(ENABLE, gate.permission == TOLD_STOP ? LOW : HIGH);
  digitalWrite(LED_BUILTIN, gate.permission == TOLD_GO ? HIGH : LOW);
  throttle.writeMicroseconds(allowed_us(wanted_us(now_ms)));
  count_presses(now_ms);
  if (accepted || gate.permission != reported || now_ms - reported_ms >= REPORT_EVERY_MS) {
    uint8_t out[REPORT_BYTES];
    gate.report(presses, out);
    if (Serial.availableForWrite() >= REPORT_BYTES) Serial.write(out, REPORT_BYTES);
    reported_ms = now_ms;
    reported = gate.permission;
  }
}
