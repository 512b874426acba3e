"""When a sensor is better again: after a few good frames in a row, after many while its faults come and go.

Fusion keeps this over a restart of its own (``habit``, ``resume``), so that one that has just started judges like one
that never stopped.
"""

from __future__ import annotations

from collections import deque

import msgspec

from common.messages import SensorState
from services.jetson.fusion.config import HealthConfig

RANK_OF_STATE: dict[SensorState, int] = {"online": 0, "degraded": 1, "disconnected": 2}
RESUME_GRACE_S = 1.0  # two measurements of every clock: until then we may be wrong about its data's age


class Habit(msgspec.Struct, frozen=True):
    """How one sensor was doing; times are monotonic."""

    state: SensorState
    reported: bool  # it has sent a message since start-up began
    good_frames: int = 0
    fresh_frames: int = 0
    faults_s: tuple[float, ...] = ()  # when its last faults began


class Recovery:
    """Counts good frames and faults of one sensor. A state here is what is wrong now; "online" is nothing."""

    def __init__(self, config: HealthConfig) -> None:
        self._config = config
        self.good_frames = 0  # in a row without any fault
        self.fresh_frames = 0  # in a row that came in time
        self._begun_s: deque[float] = deque(maxlen=2)  # when the last faults began
        self._faulty = False
        self._resumed: SensorState | None = None  # before our restart; until it is there again, or worse by itself
        self._strange_until_s = 0.0

    def note_frame(self, now_s: float, state: SensorState) -> None:
        """A frame has come, and this is wrong with it."""
        self.good_frames = self.good_frames + 1 if state == "online" else 0
        self.fresh_frames = 0 if state == "disconnected" else self.fresh_frames + 1
        if now_s >= self._strange_until_s:
            self._note(now_s, faulty=state != "online")

    def note_fault(self, now_s: float, state: SensorState, *, reported: bool) -> None:
        """Something is wrong without a frame; before the first one it is start-up and no fault."""
        if now_s < self._strange_until_s:
            return
        self.good_frames = 0
        self.fresh_frames = 0 if state == "disconnected" else self.fresh_frames
        if reported:
            self._note(now_s, faulty=True)
            if self._resumed is not None and RANK_OF_STATE[state] > RANK_OF_STATE[self._resumed]:
                self._resumed = state

    def _note(self, now_s: float, *, faulty: bool) -> None:
        if faulty and not self._faulty:
            self._begun_s.append(now_s)
        self._faulty = faulty

    def lacks(self, now_s: float, was: SensorState, state: SensorState) -> str:
        """Why it may not pass from one state to a better one yet; empty when it may."""
        frames = self.good_frames if state == "online" else self.fresh_frames
        needed = self._frames_needed(now_s, state)
        if RANK_OF_STATE[state] >= RANK_OF_STATE[was] or frames >= needed:
            return ""
        return f"recovering, {frames} of {needed} good frames"

    def _frames_needed(self, now_s: float, state: SensorState) -> int:
        back = self._resumed is not None and RANK_OF_STATE[state] >= RANK_OF_STATE[self._resumed]
        flickers = len(self._begun_s) == 2 and now_s - self._begun_s[0] <= self._config.flicker_s
        return self._config.flicker_frames if flickers and not back else self._config.recovery_frames

    def judged(self, state: SensorState) -> None:
        """The sensor is in this state now."""
        if self._resumed is not None and RANK_OF_STATE[state] <= RANK_OF_STATE[self._resumed]:
            self._resumed = None

    def habit(self, state: SensorState, *, reported: bool) -> Habit:
        """What a successor has to know."""
        state = state if self._resumed is None else self._resumed
        return Habit(state, reported, self.good_frames, self.fresh_frames, tuple(self._begun_s))

    def resume(self, now_s: float, habit: Habit) -> None:
        """Go on where another process stopped: that we were away, and do not know its clock yet, is no fault of it."""
        self._resumed, self._faulty = habit.state, habit.state != "online"
        self._strange_until_s = now_s + RESUME_GRACE_S
        self._begun_s.extend(habit.faults_s)
        self.good_frames, self.fresh_frames = habit.good_frames, habit.fresh_frames
