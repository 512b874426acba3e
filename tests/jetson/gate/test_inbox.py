"""What arrives on fusion's key: versions, rubbish, age, order, and who says it is fusion."""

from __future__ import annotations

from typing import Any

import msgspec

from common.bus.presence import successor
from common.codec import encode, encoding_of
from common.messages import Verdict
from services.jetson.gate.inbox import Arrival, VerdictInbox

T_NS = 10**18
ENCODING = encoding_of(Verdict)


def arrival(seq: int, at_s: float, *, stamped_s: float | None = None, **changes: Any) -> Arrival:
    """A verdict that was stamped at ``stamped_s`` (at once, if not given) and arrives at ``at_s``."""
    stamp_ns = T_NS + round((at_s if stamped_s is None else stamped_s) * 1e9)
    verdict = Verdict(
        stamp_ns=stamp_ns, seq=seq, level="SAFE", rule="R0-clear", because="x", inputs={}, confirmed=False,
        suppressed=False, advisory=None, blind=False, permission="GO",
    )  # fmt: skip
    return Arrival(encode(msgspec.structs.replace(verdict, **changes)), ENCODING, at_s, T_NS + round(at_s * 1e9))


def inbox(*instances: str) -> VerdictInbox:
    one = VerdictInbox()
    one.meet(instances or ("a1",))
    return one


def test_a_verdict_ages_from_its_stamp_and_on_our_own_clock() -> None:
    one = inbox()
    one.take(arrival(1, 5.0, stamped_s=4.9))
    assert abs(one.inputs(5.05).age_s - 0.15) < 1e-9
    one.take(arrival(2, 6.0, stamped_s=6.5))
    assert abs(one.inputs(6.1).age_s + 0.4) < 1e-9


def test_nothing_heard_and_nobody_there() -> None:
    inputs = VerdictInbox().inputs(1.0)
    assert (inputs.verdict, inputs.claimants) == (None, ())


def test_another_version_and_rubbish_are_refused_until_a_verdict_comes() -> None:
    one = inbox()
    one.take(arrival(1, 5.0))
    one.take(arrival(2, 5.1)._replace(encoding="application/msgpack;spotter.Verdict.v2"))
    assert "unknown version" in one.inputs(5.1).refused
    one.take(arrival(2, 5.2))
    assert one.inputs(5.2).refused == ""
    one.take(arrival(3, 5.3)._replace(payload=b"rubbish"))
    assert one.inputs(5.3).refused.startswith("undecodable")


def test_a_repetition_does_not_make_a_verdict_younger() -> None:
    one = inbox()
    first = arrival(1, 5.0)
    one.take(first)
    one.take(first._replace(at_s=5.2, at_ns=first.at_ns + 2 * 10**8))
    assert abs(one.inputs(5.2).age_s - 0.2) < 1e-9
    assert one.ignored == 1


def test_a_number_that_goes_back_is_another_sender() -> None:
    one = inbox()
    one.take(arrival(1, 5.0))
    one.take(arrival(900, 5.02))  # an impostor that counts ahead
    one.take(arrival(2, 5.04))
    assert one.inputs(5.05).two_senders
    assert one.inputs(7.0).two_senders
    assert not one.inputs(7.05).two_senders


def test_a_restarted_fusion_counts_from_the_beginning() -> None:
    one = inbox("a1")
    one.take(arrival(900, 5.0))
    one.meet(())
    assert one.inputs(5.1).claimants == ()
    one.meet(("b2",))
    one.take(arrival(0, 5.2))
    inputs = one.inputs(5.2)
    assert (inputs.claimants, inputs.two_senders) == (("b2",), False)


def test_an_announced_successor_may_count_on_its_own() -> None:
    one = inbox("a1")
    one.take(arrival(900, 5.0))
    new = successor("b2", "a1")
    one.meet(("a1", new))
    one.take(arrival(7, 5.02))
    one.take(arrival(901, 5.03))
    inputs = one.inputs(5.04)
    assert (inputs.claimants, inputs.two_senders) == ((new,), False)
    one.meet((new,))
    one.take(arrival(902, 5.05))
    assert not one.inputs(5.05).two_senders


def test_two_processes_that_claim_it_are_both_named() -> None:
    assert inbox("a1", "b2").inputs(1.0).claimants == ("a1", "b2")
