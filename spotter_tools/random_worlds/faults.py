"""What goes wrong in a random world: of a sensor, of fusion, of clocks, of what is said of the motion."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

SENSORS = ("lidar", "radar", "camera")
KINDS = ("kill", "silent", "late", "covered", "flicker", "unplugged", "clock", "heal", "heal")


@dataclass
class Line:
    """One sensor's state, from the device to fusion."""

    alive: bool = True
    instance: int = 0
    silent: bool = False
    unplugged: bool = False
    covered: bool = False
    delay_s: float = 0.02
    loss: float = 0.0  # share of messages that get lost
    bad: float = 0.0  # share of frames that it calls degraded
    clock_s: float = 0.0  # its clock minus ours
    fitted: bool = True

    def heal(self) -> None:
        """All is well again, after a restart of the process."""
        self.alive, self.silent, self.unplugged, self.covered = True, False, False, False
        self.delay_s, self.loss, self.bad, self.clock_s, self.instance = 0.02, 0.0, 0.0, 0.0, self.instance + 1


@dataclass
class Faults:
    """Draws one fault after the other; ``lines`` is what they left."""

    dice: random.Random
    lines: dict[str, Line] = field(default_factory=lambda: {name: Line() for name in SENSORS})
    isolated: bool = False
    own_clock_s: float = 0.0  # our UTC clock's error
    ego: str = "none"  # none | true | reversed | wrong | stuck
    ego_scale: float = 1.0
    changed_s: float = 0.0  # when the last one struck

    def strike(self, now_s: float) -> bool:
        """One more fault; True when it is a restart of fusion."""
        self.changed_s = now_s
        what = self.dice.random()
        if what < 0.12:
            return True
        if what < 0.17:
            self.isolated = not self.isolated
        elif what < 0.22:
            self.own_clock_s += self.dice.uniform(-2.0, 2.0)
        elif what < 0.32:
            self.ego = self.dice.choice(("none", "true", "reversed", "wrong", "stuck"))
            self.ego_scale = self.dice.uniform(0.75, 1.3)
        else:
            self._break(self.lines[self.dice.choice(SENSORS)], self.dice.choice(KINDS))
        return False

    def calm(self, now_s: float) -> None:
        """Everything works from now on, for as long as nothing strikes."""
        self.isolated, self.changed_s = False, now_s
        for line in self.lines.values():
            line.heal()

    def _break(self, line: Line, kind: str) -> None:
        dice = self.dice
        if kind == "kill":
            line.alive = False
        elif kind == "silent":
            line.silent = True
        elif kind == "late":
            line.delay_s, line.loss = dice.choice((0.1, 0.4, 2.0)), dice.choice((0.0, 0.3))
        elif kind == "covered":
            line.covered = True
        elif kind == "flicker":
            line.bad = 0.3
        elif kind == "unplugged":
            line.unplugged = line.silent = True
        elif kind == "clock":
            line.clock_s = dice.choice((-30.0, -0.3, 0.3, 30.0))
        else:
            line.heal()
