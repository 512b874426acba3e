"""The switchover: promote the candidate, stop the old service, watch the new one, roll back if it fails."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field

from common.bus.presence import AFTER
from common.clock import monotonic_s
from common.messages import ServiceInfo
from spotter_tools.swap.candidate import Candidate, Predecessor
from spotter_tools.swap.compare import Comparison, Received
from spotter_tools.swap.order import Order, Outcome, Refused
from spotter_tools.swap.taps import START_BUDGET_S, SwapTaps
from spotter_tools.swap.watch import Gap, by_sender, measure_switchover

SWITCHOVER_BUDGET_S = 5.0


@dataclass
class Switchover:
    """One switchover from a live service to a candidate that has passed the comparison; ``run`` it once."""

    order: Order
    taps: SwapTaps
    old: ServiceInfo
    predecessor: Predecessor
    candidate: Candidate
    comparison: Comparison
    say: Callable[[str], None]
    before: list[Received] = field(init=False)  # live messages until the promotion
    shadow_seq: int = field(init=False)  # the candidate's last sequence number in the shadow

    def __post_init__(self) -> None:
        self.before = self.taps.live.since(0.0)
        self.shadow_seq = self.taps.shadow.since(0.0)[-1].message.seq

    def run(self) -> Outcome:
        """The candidate publishes before the old service stops, so that no message is missing in between.

        Raises:
            Refused: the candidate does not publish under the live key, or the old service, which still runs, cannot
                be stopped.
        """
        new = self._promote()
        try:
            self.predecessor.inform_supervisor(self.candidate.live, kept=False)
            self.predecessor.stop()
        except (OSError, subprocess.SubprocessError) as error:
            raise Refused(f"{self.old.instance} cannot be stopped: {error}", comparison=self.comparison) from None
        self.taps.promoted = True
        self.say(f"{new} is live, {self.old.instance} is stopped; watching for {self.order.probation_s:g} s")
        gone = self.taps.wait_instances(lambda ids: self.old.instance not in ids, SWITCHOVER_BUDGET_S)
        watched = self._watch()
        by_old, by_new = self._by_sender(self.taps.live.since(0.0))
        gap = self._gap(by_old, by_new)
        faults = self._faults(len(by_new), watched)
        if faults:
            return self._roll_back(faults, gap)
        self.predecessor.inform_supervisor(self.candidate.live, kept=True)
        notes = [] if gone else [f"{self.old.instance} still runs: stop it yourself"]
        notes += [] if watched else ["interrupted: the new one was not watched to the end"]
        return Outcome(
            promoted=True,
            reasons=tuple(notes),
            comparison=self.comparison,
            switchover=gap,
            old=self.old.instance,
            new=new,
            pid=self.candidate.pid,
            supervised=self.predecessor.inbox is not None,
        )

    def _promote(self) -> str:
        """Wait for the candidate's token and for its first message under the live key; returns its instance."""
        succeeded = AFTER + self.old.instance.partition(AFTER)[0]
        self.candidate.promote()
        if not self.taps.wait_instances(lambda ids: any(i.endswith(succeeded) for i in ids), SWITCHOVER_BUDGET_S):
            reason = self.candidate.ended() or "it did not announce itself after SIGUSR1"
            raise Refused(reason, comparison=self.comparison)
        if not self.taps.live.wait(
            lambda received: self._by_sender(received)[1], SWITCHOVER_BUDGET_S, self.candidate.ended
        ):
            silent = "it announced itself, but no message under the live key continues the shadow's sequence numbers"
            raise Refused(self.candidate.ended() or silent, comparison=self.comparison)
        return next(i for _, _, i in self.taps.presence.instances() if i.endswith(succeeded))

    def _watch(self) -> bool:
        """Watch the new service for the probation time; False when the user interrupts it."""
        try:
            self.taps.live.wait(lambda _: False, self.order.probation_s, self.candidate.ended)
        except KeyboardInterrupt:
            return False
        return True

    def _by_sender(self, received: list[Received]) -> tuple[list[Received], list[Received]]:
        """Messages since the promotion: the old service's and the candidate's."""
        return by_sender(received[len(self.before) :], self.before[-1].message.seq, self.shadow_seq)

    def _gap(self, by_old: list[Received], by_new: list[Received]) -> Gap:
        verdicts, health = (tap.since(self.before[0].arrived_s) for tap in (self.taps.verdicts, self.taps.health))
        return measure_switchover(self.order.service, self.before, by_old, by_new, verdicts, health)

    def _faults(self, messages: int, watched: bool) -> list[str]:
        """Why the candidate must be rolled back, after ``messages`` of it; empty if it may stay."""
        ended, seconds = self.candidate.ended(), self.order.probation_s
        faults = [ended] if ended else []
        if watched and messages < self.order.limits.rate * self.comparison.live_hz * seconds:
            faults.append(f"only {messages} messages in {seconds:g} s after the switchover")
        return faults

    def _roll_back(self, faults: list[str], gap: Gap) -> Outcome:
        """Start the old service again as it was."""
        self.candidate.stop()
        begun_s, log = monotonic_s(), self.order.log
        reasons = list(faults)
        if self.predecessor.start_again(log):
            back = self.taps.live.wait(lambda received: received[-1].arrived_s > begun_s, START_BUDGET_S, lambda: False)
            reasons.append("the old service runs again" if back else f"the old service does not come back; see {log}")
        else:
            reasons.append("the old service could not be started again and no process replaces it: start it yourself")
        return Outcome(
            promoted=False,
            reasons=tuple(reasons),
            comparison=self.comparison,
            switchover=gap,
            supervised=self.predecessor.inbox is not None,
        )
