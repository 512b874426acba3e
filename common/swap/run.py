"""The steps of a swap, in order. Whatever goes wrong before the old service is stopped leaves it as it was."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import msgspec
import zenoh

from common import topics
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import ServiceInfo
from common.presence import AFTER, Presence
from common.security.rules import SHADOW
from common.swap.candidate import Candidate, Live, Predecessor, command_line
from common.swap.compare import Comparison, Heard, Limits, compare, refuse
from common.swap.watch import Ear, Gap, handover_seen, primary, speakers

START_BUDGET_S = 90.0
HANDOVER_BUDGET_S = 5.0


@dataclass(frozen=True)
class Order:
    """What the command line of ``spotter swap`` asks for."""

    service: str
    host: str
    candidate: str
    seconds: float
    probation_s: float
    limits: Limits
    connect: str
    namespace: str
    stop_command: str
    start_command: str
    log: Path
    dry_run: bool


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    promoted: bool
    reasons: tuple[str, ...] = ()
    comparison: Comparison | None = None
    handover: Gap | None = None
    old: str = ""
    new: str = ""
    pid: int | None = None
    supervised: bool = False  # by the supervisor that had started the old one


class Refused(Exception):
    """The swap does not go on; ``comparison`` if it came that far."""

    def __init__(self, *reasons: str, comparison: Comparison | None = None) -> None:
        super().__init__("; ".join(reasons))
        self.reasons, self.comparison = reasons, comparison


def swap(session: zenoh.Session, order: Order, say: Callable[[str], None]) -> tuple[Outcome, Live | None]:
    """Start the candidate in the shadow, compare, hand over, watch; or refuse and leave everything as it was.

    Returns what became of it, and the process of ours that speaks for the service now, if there is one: mind it.
    """
    with ExitStack() as stack:
        try:
            old = _running(session, order)
            predecessor = Predecessor(order.service, old.pid, order.stop_command, order.start_command)
            if not predecessor.reachable:
                raise Refused(f"process {old.pid} is not on this machine: run swap there, or give --stop")
            ears = _Ears(session, order, stack)
            candidate = _start(order, old, predecessor)
            stack.callback(lambda: candidate.stop() if not ears.promoted else None)
            comparison = _compare(order, ears, candidate, say)
            if order.dry_run:
                return Outcome(promoted=False, comparison=comparison, old=old.instance), None
            outcome = _hand_over(order, ears, candidate, predecessor, old, comparison, say)
            if outcome.supervised:
                return outcome, None
            return outcome, candidate.live if outcome.promoted else predecessor.live
        except Refused as refused:
            return Outcome(promoted=False, reasons=refused.reasons, comparison=refused.comparison), None
        except KeyboardInterrupt:
            return Outcome(promoted=False, reasons=("interrupted; the old service goes on",)), None


class _Ears:
    """Everything a swap listens to."""

    def __init__(self, session: zenoh.Session, order: Order, stack: ExitStack) -> None:
        topic = primary(order.service)
        key = topic.key(order.host)
        self.topic = topic
        self.live = Ear(session, key, topic)
        self.shadow = Ear(session, f"{SHADOW}/{key}", topic)
        self.verdicts = Ear(session, topics.FUSION_VERDICT.any_host, topics.FUSION_VERDICT)
        self.health = Ear(session, topics.FUSION_HEALTH.any_host, topics.FUSION_HEALTH)
        self.changed = threading.Event()
        self.presence = Presence(
            session, lambda _: self.changed.set(), topics.token_key(order.host, order.service, "*")
        )
        self.promoted = False
        for ear in (self.live, self.shadow, self.verdicts, self.health, self.presence):
            stack.callback(ear.close)

    def wait_instances(self, wanted: Callable[[set[str]], bool], budget_s: float) -> bool:
        """Until the tokens are as wanted."""
        deadline_s = monotonic_s() + budget_s
        while not wanted({instance for _, _, instance in self.presence.instances()}):
            if monotonic_s() > deadline_s:
                return False
            self.changed.wait(0.1)
            self.changed.clear()
        return True


def _running(session: zenoh.Session, order: Order) -> ServiceInfo:
    """The one live instance."""
    found: list[ServiceInfo] = []
    key, everybody = topics.info_key(order.host, order.service), zenoh.QueryTarget.ALL
    for reply in session.get(key, target=everybody, consolidation=zenoh.ConsolidationMode.NONE, timeout=2.0):
        try:
            found += [decode(reply.ok.payload.to_bytes(), ServiceInfo)] if reply.ok is not None else []
        except DecodeError:
            continue
    if len(found) != 1:
        raise Refused(f"{order.host}/{order.service}: {len(found)} processes answer, one is needed")
    return found[0]


def _start(order: Order, old: ServiceInfo, predecessor: Predecessor) -> Candidate:
    told = {
        "SPOTTER_HOST": order.host,
        "SPOTTER_CONNECT": order.connect,
        "SPOTTER_NAMESPACE": order.namespace,
        **predecessor.inherited,
    }
    words = command_line(order.candidate, order.host, order.connect, order.namespace)
    try:
        return Candidate(words, told, old.instance.partition(AFTER)[0], order.log)
    except OSError as error:
        raise Refused(f"cannot start {words[0]}: {error.strerror}") from None


def _compare(order: Order, ears: _Ears, candidate: Candidate, say: Callable[[str], None]) -> Comparison:
    """Wait until the candidate is warm, then listen to both for ``seconds``."""
    say(f"candidate {candidate.pid} in the shadow; log in {order.log}")
    if not ears.shadow.wait(lambda heard: any(map(_is_online, heard)), START_BUDGET_S, candidate.ended):
        late = f"it was not online within {START_BUDGET_S:.0f} s; see {order.log}"
        raise Refused(candidate.ended() or ears.shadow.wrong or late)
    say(f"it is online; comparing for {order.seconds:g} s")
    start_s = monotonic_s()
    if ears.live.wait(lambda _: False, order.seconds, candidate.ended) or candidate.ended():
        raise Refused(candidate.ended())
    comparison = compare(ears.topic, monotonic_s() - start_s, ears.live.since(start_s), ears.shadow.since(start_s))
    reasons = refuse(comparison, order.limits)
    if ears.shadow.undecodable:
        reasons.append(f"{ears.shadow.undecodable} of its messages cannot be decoded")
    if reasons:
        raise Refused(*reasons, comparison=comparison)
    return comparison


def _hand_over(
    order: Order,
    ears: _Ears,
    candidate: Candidate,
    predecessor: Predecessor,
    old: ServiceInfo,
    comparison: Comparison,
    say: Callable[[str], None],
) -> Outcome:
    """The new one is there and heard, then the old one is stopped, then both sides of the moment are looked at."""
    before, shadow = ears.live.since(0.0), ears.shadow.since(0.0)

    def spoken(heard: list[Heard]) -> tuple[list[Heard], list[Heard]]:
        return speakers(heard[len(before) :], before[-1].message.seq, shadow[-1].message.seq)

    succeeded = AFTER + old.instance.partition(AFTER)[0]
    candidate.promote()
    if not ears.wait_instances(lambda ids: any(i.endswith(succeeded) for i in ids), HANDOVER_BUDGET_S):
        raise Refused(candidate.ended() or "it did not announce itself after SIGUSR1", comparison=comparison)
    if not ears.live.wait(lambda heard: spoken(heard)[1], HANDOVER_BUDGET_S, candidate.ended):
        deaf = "it announced itself, but under the live key nobody heard a message whose seq goes on from the shadow's"
        raise Refused(candidate.ended() or deaf, comparison=comparison)
    new = next(i for _, _, i in ears.presence.instances() if i.endswith(succeeded))
    predecessor.tell_supervisor(candidate.live, kept=False)
    predecessor.stop()
    ears.promoted = True
    say(f"{new} is live, {old.instance} is stopped; watching for {order.probation_s:g} s")
    gone = ears.wait_instances(lambda ids: old.instance not in ids, HANDOVER_BUDGET_S)
    watched = _watch(ears, candidate, order.probation_s)
    by_old, by_new = spoken(ears.live.since(0.0))
    verdicts, health = (ear.since(before[0].arrived_s) for ear in (ears.verdicts, ears.health))
    seen = handover_seen(order.service, before, by_old, by_new, verdicts, health)
    reasons = [candidate.ended()] if candidate.ended() else []
    if watched and len(by_new) < order.limits.rate * comparison.live_hz * order.probation_s:
        reasons.append(f"only {len(by_new)} messages in {order.probation_s:g} s after the handover")
    if reasons:
        return _roll_back(order, ears, candidate, predecessor, reasons, comparison, seen)
    predecessor.tell_supervisor(candidate.live, kept=True)
    warnings = [] if gone else [f"{old.instance} still runs: stop it yourself"]
    warnings += [] if watched else ["interrupted: the new one was not watched to the end"]
    return Outcome(
        promoted=True,
        reasons=tuple(warnings),
        comparison=comparison,
        handover=seen,
        old=old.instance,
        new=new,
        pid=candidate.pid,
        supervised=predecessor.inbox is not None,
    )


def _watch(ears: _Ears, candidate: Candidate, seconds: float) -> bool:
    """The probation; False when a person ends it: there is no way back to the old one without a gap then."""
    try:
        ears.live.wait(lambda _: False, seconds, candidate.ended)
    except KeyboardInterrupt:
        return False
    return True


def _roll_back(
    order: Order,
    ears: _Ears,
    candidate: Candidate,
    predecessor: Predecessor,
    reasons: list[str],
    comparison: Comparison,
    seen: Gap,
) -> Outcome:
    """The old one is started again as it was."""
    candidate.stop()
    begun_s = monotonic_s()
    if predecessor.start_again(order.log):
        back = ears.live.wait(lambda heard: heard[-1].arrived_s > begun_s, START_BUDGET_S, lambda: False)
        reasons.append("the old service runs again" if back else f"the old service does not come back; {order.log}")
    return Outcome(
        promoted=False,
        reasons=tuple(reasons),
        comparison=comparison,
        handover=seen,
        supervised=predecessor.inbox is not None,
    )


def _is_online(heard: Heard) -> bool:
    return getattr(heard.message, "state", "online") == "online" and getattr(heard.message, "settled", True)
