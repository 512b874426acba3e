"""Messages of ROS 2: their definitions, hashes (RIHS01, REP-2016) and CDR, by the library ``rosbags``.

The standard packages are in the library; further ones stand in ``msg/<package>/<Type>.msg``: vision_msgs 4,
autoware_perception_msgs 1, the packets of drivers (velodyne_msgs, ouster_sensor_msgs, hesai_ros_driver, pandar_msgs,
robosense_msgs, rslidar_msg, nebula_msgs), and our own spotter_msgs.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from common.ros2.stamps import NS

DEFINITIONS = Path(__file__).parent / "msg"
_EMPTY: Mapping[str, Any] = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}  # else 0


class CdrError(ValueError):
    """Bytes that are no such message; the text says why."""


@cache
def _store() -> Typestore:
    """Jazzy's types, whose hashes are those of every distribution from Iron to Lyrical, and ours."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path in sorted(DEFINITIONS.glob("*/*.msg")):
        types |= get_types_from_msg(path.read_text(encoding="utf-8"), f"{path.parent.name}/msg/{path.stem}")
    store.register(types)
    return store


def type_store() -> Typestore:
    """All types that are known, for what reads bags that define none. Not to be changed."""
    return _store()


def type_hash(name: str) -> str:
    """``RIHS01_`` and 64 hex digits. Raises ``KeyError`` for a type that is not known."""
    return _store().hash_rihs01(name)


def definition(name: str) -> str:
    """The text of a type's .msg file with those of all types in it, as bags and other tools take it."""
    return _store().generate_msgdef(name, ros_version=2)[0]


def to_cdr(message: Any) -> bytes:
    """Little-endian CDR with its four bytes of encapsulation."""
    return bytes(_store().serialize_cdr(message, message.__msgtype__))


def from_cdr(data: bytes, name: str) -> Any:
    """A message of this type: attributes as in its definition, numeric arrays as numpy arrays.

    Raises:
        CdrError: the bytes are no such message.
    """
    if len(data) < 4 or data[0] or data[1] not in (0, 1):
        raise CdrError(f"{len(data)} bytes without the head of CDR")
    try:
        return _store().deserialize_cdr(data, name)
    except (SerdeError, struct.error, ValueError, LookupError, AssertionError, OverflowError, MemoryError) as error:
        raise CdrError(f"no {name}: {error or type(error).__name__}") from None


def build(name: str, /, **given: Any) -> Any:
    """A message of this type; what is not given is zero or empty. Sequences of numbers become arrays of their type.

    Raises:
        TypeError: the type has no such field.
    """
    store, values = _store(), {}
    for field, description in store.fielddefs[name][1]:
        values[field] = _fitting(description, given.pop(field)) if field in given else _zero(description)
    if given:
        raise TypeError(f"{name} has no field {', '.join(given)}")
    return store.types[name](**values)


def _zero(description: Any) -> Any:
    kind, about = description
    if kind == Nodetype.BASE:
        return _EMPTY.get(about[0], 0)
    if kind == Nodetype.NAME:
        return build(about)
    element, count = about
    count = count if kind == Nodetype.ARRAY else 0
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return np.zeros(count, element[1][0])
    return [_zero(element) for _ in range(count)]


def _fitting(description: Any, value: Any) -> Any:
    kind, about = description
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and about[0][0] == Nodetype.BASE and about[0][1][0] != "string":
        return np.asarray(value, about[0][1][0])
    return value


def header(stamp_ns: int, frame_id: str) -> Any:
    """std_msgs/Header of a measurement."""
    return build("std_msgs/msg/Header", stamp=time_of(stamp_ns), frame_id=frame_id)


def time_of(ns: int) -> Any:
    """builtin_interfaces/Time of UTC nanoseconds."""
    return build("builtin_interfaces/msg/Time", sec=ns // NS, nanosec=ns % NS)


def ns_of(time: Any) -> int:
    """UTC nanoseconds of a builtin_interfaces/Time."""
    return int(time.sec) * NS + int(time.nanosec)
