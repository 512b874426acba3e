"""The steps of a swap, in order. A failure before the old service is stopped does not change anything."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

import zenoh

from common import topics
from common.bus.presence import AFTER
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.messages import ServiceInfo
from spotter_tools.swap.candidate import Candidate, Live, Predecessor, command_line
from spotter_tools.swap.compare import Comparison, Received, compare, refuse
from spotter_tools.swap.order import Order, Outcome, Refused
from spotter_tools.swap.switchover import Switchover
from spotter_tools.swap.taps import START_BUDGET_S, SwapTaps


def swap(session: zenoh.Session, order: Order, say: Callable[[str], None]) -> tuple[Outcome, Live | None]:
    """Start the candidate in the shadow, compare, switch over, watch; or refuse and leave everything as it was.

    Returns the outcome, and the process started here that runs the service now, if no supervisor restarts it.
    """
    with ExitStack() as stack:
        try:
            old = _running(session, order)
            predecessor = Predecessor(order.service, old.pid, order.stop_command, order.start_command)
            if not predecessor.reachable:
                raise Refused(f"process {old.pid} is not on this machine: run swap there, or give --stop")
            taps = SwapTaps(session, order.service, order.host, stack)
            candidate = _start(order, old, predecessor)
            stack.callback(lambda: candidate.stop() if not taps.promoted else None)
            comparison = _compare(order, taps, candidate, say)
            if order.dry_run:
                return Outcome(promoted=False, comparison=comparison, old=old.instance), None
            outcome = Switchover(order, taps, old, predecessor, candidate, comparison, say).run()
            if outcome.supervised:
                return outcome, None
            return outcome, candidate.live if outcome.promoted else predecessor.live
        except Refused as refused:
            return Outcome(promoted=False, reasons=refused.reasons, comparison=refused.comparison), None
        except KeyboardInterrupt:
            return Outcome(promoted=False, reasons=("interrupted; the old service goes on",)), None


def _running(session: zenoh.Session, order: Order) -> ServiceInfo:
    """The one live instance."""
    found: list[ServiceInfo] = []
    key, all_of_them = topics.info_key(order.host, order.service), zenoh.QueryTarget.ALL
    for reply in session.get(key, target=all_of_them, consolidation=zenoh.ConsolidationMode.NONE, timeout=2.0):
        try:
            found += [decode(reply.ok.payload.to_bytes(), ServiceInfo)] if reply.ok is not None else []
        except DecodeError:
            continue
    if len(found) != 1:
        raise Refused(f"{order.host}/{order.service}: {len(found)} processes answer, one is needed")
    return found[0]


def _start(order: Order, old: ServiceInfo, predecessor: Predecessor) -> Candidate:
    environment = {
        "SPOTTER_HOST": order.host,
        "SPOTTER_CONNECT": order.connect,
        "SPOTTER_NAMESPACE": order.namespace,
        **predecessor.inherited,
    }
    words = command_line(order.candidate, order.host, order.connect, order.namespace)
    try:
        return Candidate(words, environment, old.instance.partition(AFTER)[0], order.log)
    except OSError as error:
        what = f"--log {order.log}" if error.filename == str(order.log) else f"cannot start {words[0]}"
        raise Refused(f"{what}: {error.strerror}") from None


def _compare(order: Order, taps: SwapTaps, candidate: Candidate, say: Callable[[str], None]) -> Comparison:
    """Wait until the candidate is online, then receive both for ``seconds``."""
    say(f"candidate {candidate.pid} in the shadow; log in {order.log}")
    if not taps.shadow.wait(lambda received: any(map(_is_online, received)), START_BUDGET_S, candidate.ended):
        late = f"it was not online within {START_BUDGET_S:.0f} s; see {order.log}"
        raise Refused(candidate.ended() or taps.shadow.wrong or late)
    say(f"it is online; comparing for {order.seconds:g} s")
    start_s = monotonic_s()
    if taps.live.wait(lambda _: False, order.seconds, candidate.ended) or candidate.ended():
        raise Refused(candidate.ended())
    comparison = compare(taps.topic, monotonic_s() - start_s, taps.live.since(start_s), taps.shadow.since(start_s))
    reasons = refuse(comparison, order.limits)
    if taps.shadow.undecodable:
        reasons.append(f"{taps.shadow.undecodable} of its messages cannot be decoded")
    if reasons:
        raise Refused(*reasons, comparison=comparison)
    return comparison


def _is_online(received: Received) -> bool:
    return getattr(received.message, "state", "online") == "online" and getattr(received.message, "settled", True)
