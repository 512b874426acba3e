"""Whatever a sender puts into a message, the readers' schema accepts what travels, or nothing is sent."""

from __future__ import annotations

import math
import typing
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common import messages as m
from common.codec import EncodeError, decode, encode_for_readers, to_builtins
from common.topics import DATA_TOPICS, RAW_TOPICS, status_topic

PUBLISHED = [topic.message for topic in (*DATA_TOPICS, *RAW_TOPICS, status_topic("*"))]
ANSWERS = [m.ServiceInfo, m.ClockReply, m.RouterLinks]
SENT = list(dict.fromkeys([*PUBLISHED, *ANSWERS]))
floats = st.one_of(st.floats(), st.sampled_from([1e12, -1.8e12, 1e300, math.inf, -math.inf, math.nan, -0.0, 5e-324]))
ints = st.one_of(st.integers(-10, 10), st.integers(0, 2**64 - 1), st.sampled_from([-(2**63), 2**64 - 1, -1]))
texts = st.one_of(st.text(max_size=20), st.integers(90, 2100).map(lambda n: "x" * n))


SHAPES = {  # of messages that refuse arrays which do not fit one another
    m.LaserScan: {"angles_rad": (4,), "ranges_m": (4,), "confidence": (4,), "used": (4,)},
    m.RadarDetections: {"range_doppler_db": (2, 3), "range_axis_m": (2,), "velocity_axis_mps": (3,)},
    m.PointCloud: {"points": (5, 3), "intensity": (5,), "kind": (5,)},
}


def array(shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    kinds = st.sampled_from(["<f4", ">f4", "<f8", "|u1", "<i8", "?"])
    return st.builds(lambda kind, value: np.full(shape, value).astype(kind), kinds, st.sampled_from([0, 1, 255]))


def values(kind: Any) -> st.SearchStrategy[Any]:
    """Values of the right type for a field, not of the right size."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return values(arguments[0])
    if origin is typing.Literal:
        return st.sampled_from(arguments)
    if origin is dict:
        return st.dictionaries(texts, values(arguments[1]), max_size=3)
    if origin is list:
        return st.lists(values(arguments[0]), max_size=7)
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(values(arguments[0]), max_size=7).map(tuple)
    if origin is tuple:
        return st.tuples(*map(values, arguments))
    if origin is not None or isinstance(kind, type(int | None)):
        return st.one_of(*map(values, arguments))
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return st.deferred(lambda: structs(kind))
    plain = {
        float: floats, int: ints, str: texts, bool: st.booleans(), bytes: st.binary(max_size=9), object: st.just(1),
        type(None): st.none(), np.ndarray: array((2, 3)),
    }  # fmt: skip
    return plain[kind]


def structs(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    fields = {name: values(hint) for name, hint in typing.get_type_hints(kind, include_extras=True).items()}
    fields |= {name: array(shape) for name, shape in SHAPES.get(kind, {}).items()}

    def build(drawn: dict[str, Any]) -> Any:
        try:
            return kind(**drawn)
        except ValueError:  # it refuses the shape of an array: then it cannot be sent either
            return None

    return st.fixed_dictionaries(fields).map(build)


@pytest.mark.parametrize("kind", SENT, ids=lambda kind: kind.__name__)
def test_what_is_sent_can_be_read(kind: type[m.Message]) -> None:
    travelled: list[bytes] = []

    @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
    @given(structs(kind))
    def holds(message: m.Message | None) -> None:
        if message is None:
            return
        try:
            payload, _ = encode_for_readers(message)
        except (EncodeError, OverflowError):
            return
        decode(payload, kind)
        travelled.append(payload)

    holds()
    assert travelled  # not every one was held back


def health(**more: Any) -> m.SystemHealth:
    clock = m.ClockHealth(offset_ms=-1.77e12, bound_ms=0.4, age_s=1.0, trusted=True)
    fields: dict[str, Any] = {"colour": "green", "summary": "s", "services": {}, "sensors": {}, "clocks": {"a": clock}}
    return m.SystemHealth(stamp_ns=1, **(fields | more))


def test_a_clock_of_1970_is_sent_as_it_is() -> None:
    message = health()
    payload, mended = encode_for_readers(message)
    assert not mended
    assert to_builtins(decode(payload, m.SystemHealth)) == to_builtins(message)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1.0, 1e300])
def test_one_bad_number_hides_nothing_else(wrong: float) -> None:
    good = m.ClockHealth(offset_ms=2.0, bound_ms=0.4, age_s=1.0, trusted=True)
    bad = m.ClockHealth(offset_ms=3.0, bound_ms=wrong, age_s=1.0, trusted=True)
    payload, mended = encode_for_readers(health(clocks={"good": good, "bad": bad}, notes=["n" * 3000]))
    read = decode(payload, m.SystemHealth)
    assert "bound_ms" in mended
    assert (read.summary, read.clocks["good"], read.notes) == ("s", good, ["n" * 2000])
    assert ("bad" in read.clocks) == (not math.isnan(wrong))


def test_a_distance_that_is_no_number_is_not_replaced_by_one() -> None:
    radar = m.RadarTracks(stamp_ns=1, tracks=[], level="SAFE", settled=True, noise_floor_db=math.nan)
    with pytest.raises(EncodeError, match="noise_floor_db"):
        encode_for_readers(radar)
