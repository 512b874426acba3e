"""Whether the interrupt line can be believed."""

from __future__ import annotations

STRIKES = 3  # wrong in a row: the line is not trusted any more ...
REHABILITATION = 50  # ... until it was right so often


class InterruptLine:
    """The line's record: it is compared with FSTAT whenever it looks wrong."""

    def __init__(self) -> None:
        self.trusted = True
        self.strikes = 0
        self._right = 0

    def compare(self, *, said: bool, truth: bool) -> None:
        """The line said so, FSTAT says the truth. Both silent tells nothing."""
        if said != truth:
            self.strikes, self._right = self.strikes + 1, 0
            self.trusted = self.trusted and self.strikes < STRIKES
        elif said:
            self._right += 1
            if self._right >= REHABILITATION:
                self.trusted, self.strikes = True, 0

    def distrust(self) -> None:
        """It announced words that were not there."""
        self.trusted, self.strikes, self._right = False, 0, 0
