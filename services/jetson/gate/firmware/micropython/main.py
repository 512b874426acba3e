"""The gate's actuator on a MicroPython board (tested layout: Raspberry Pi Pico; pins below).

Copy ``gate_receiver.py`` and this file to the board. The gate talks to UART 0, 115200 baud.

  ENABLE   relay or ESC enable, high = may move. A resistor of 10 k to ground keeps it low while the board starts.
  THROTTLE out to the ESC; the receiver's throttle comes in on RECEIVER. Without a speed controller leave both open.
  BUTTON   to ground: a person acknowledges.
"""

import time

import machine
from gate_receiver import GO, STOP, GateReceiver

ENABLE, THROTTLE, RECEIVER, BUTTON, LED = 15, 16, 17, 14, 25
NEUTRAL_US = 1500
US_PER_MPS = 60  # measure it: how far from neutral the throttle is at 1 m/s, with the wheels on the ground
MAX_US = 500
REPORT_EVERY_MS = 100
RECEIVER_LOST_MS = 100


def pulse_us(wanted_us, permission, limit_mm_s):
    """The throttle pulse that is allowed: neutral with STOP, else within the limit, reverse too."""
    if permission == STOP:
        return NEUTRAL_US
    reach_us = min(MAX_US, limit_mm_s * US_PER_MPS // 1000)
    return min(max(wanted_us, NEUTRAL_US - reach_us), NEUTRAL_US + reach_us)


class ReceiverPulse:
    """The newest throttle pulse of the radio receiver; neutral when none has come for a while."""

    def __init__(self, pin):
        self._pin, self._rise_us, self._us, self._at_ms = pin, 0, NEUTRAL_US, time.ticks_ms()
        pin.irq(self._edge, machine.Pin.IRQ_RISING | machine.Pin.IRQ_FALLING)

    def _edge(self, pin):
        now_us = time.ticks_us()
        if pin.value():
            self._rise_us = now_us
            return
        width_us = time.ticks_diff(now_us, self._rise_us)
        if 800 <= width_us <= 2200:
            self._us, self._at_ms = width_us, time.ticks_ms()

    def us(self):
        """Width of the newest pulse (us); neutral once the receiver is lost."""
        fresh = time.ticks_diff(time.ticks_ms(), self._at_ms) < RECEIVER_LOST_MS
        return self._us if fresh else NEUTRAL_US


def main():
    """Pass frames to the motor and answer, for ever."""
    enable = machine.Pin(ENABLE, machine.Pin.OUT, value=0)
    led = machine.Pin(LED, machine.Pin.OUT, value=0)
    button = machine.Pin(BUTTON, machine.Pin.IN, machine.Pin.PULL_UP)
    throttle = machine.PWM(machine.Pin(THROTTLE), freq=50, duty_ns=NEUTRAL_US * 1000)
    receiver = ReceiverPulse(machine.Pin(RECEIVER, machine.Pin.IN))
    uart = machine.UART(0, baudrate=115200)
    watchdog = machine.WDT(timeout=150)  # a board that hangs resets, and ENABLE is low
    gate, presses, was_down = GateReceiver(), 0, False
    reported, reported_ms = STOP, time.ticks_ms()
    while True:
        watchdog.feed()
        accepted = False
        for byte in uart.read(uart.any()) or b"":
            accepted = gate.feed(byte, time.ticks_ms()) or accepted
        now_ms = time.ticks_ms()
        gate.tick(now_ms)
        enable.value(gate.permission != STOP)
        led.value(gate.permission == GO)
        throttle.duty_ns(pulse_us(receiver.us(), gate.permission, gate.limit_mm_s) * 1000)
        down = not button.value()
        presses += down and not was_down
        was_down = down
        if accepted or gate.permission != reported or time.ticks_diff(now_ms, reported_ms) >= REPORT_EVERY_MS:
            uart.write(gate.report(presses))
            reported, reported_ms = gate.permission, now_ms


main()
