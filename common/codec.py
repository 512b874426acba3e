"""Message <-> msgpack. The only file that knows the wire layout.

A message is a plain msgpack map of its fields; an array is ``{"dtype": "<f4", "shape": [n, 3], "data": <bin>}``. Any
msgpack library reads it. Decoding validates every field and copies no array: it becomes a read-only view of the
payload.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Iterable
from functools import cache
from typing import Any, TypeVar

import msgspec
import numpy as np

from common.mend import mend
from common.messages import Message

MEDIA_TYPE = "application/msgpack"
MAX_PAYLOAD_BYTES = 16_000_000
ALLOWED_DTYPES = frozenset({"|u1", "|i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f4", "<f8"})

REQUIRED_ON_WIRE = frozenset({"stamp_ns", "seq", "frame_id"})  # defaults are for building messages only

M = TypeVar("M", bound=Message)


class DecodeError(ValueError):
    """A payload that is not the message it claims to be; the text names the field."""


class EncodeError(ValueError):
    """A message that no reader would accept; the text names the field."""


class WireArray(msgspec.Struct):
    """An array on the wire: numpy's name of its type, its shape (at most four axes) and its bytes, row by row."""

    dtype: str
    shape: typing.Annotated[list[typing.Annotated[int, msgspec.Meta(ge=0)]], msgspec.Meta(max_length=4)]
    data: memoryview


def encoding_of(message_type: type[Message]) -> str:
    """The Zenoh encoding, for example ``application/msgpack;spotter.Verdict.v1``."""
    return f"{MEDIA_TYPE};spotter.{message_type.__name__}.v1"


def encode(message: Message) -> bytes:
    """Message to msgpack bytes.

    Raises:
        ValueError: an array has a dtype that does not travel.
    """
    fields = {name: getattr(message, name) for name in message.__struct_fields__}
    for name in _array_fields(type(message)):
        if fields[name] is not None:
            fields[name] = _to_wire(f"{type(message).__name__}.{name}", fields[name])
    return _ENCODER.encode(fields)


def encode_for_readers(message: M) -> tuple[bytes, str]:
    """As ``encode``, checked as its readers will check it: the payload, and the error that was mended, empty if none.

    Raises:
        EncodeError: the readers would refuse it, and ``common.mend`` cannot bring it into its bounds.
    """
    payload = encode(message)
    try:
        decode(payload, type(message))
        return payload, ""
    except DecodeError as error:
        error_text = str(error)
    mended = _ENCODER.encode(mend(msgspec.msgpack.decode(payload), _decoder(type(message)).type))
    try:
        decode(mended, type(message))
    except DecodeError as error:
        raise EncodeError(str(error)) from None
    return mended, error_text


def decode(payload: bytes, message_type: type[M], max_bytes: int = MAX_PAYLOAD_BYTES) -> M:
    """Msgpack bytes to a checked message. Unknown fields are ignored.

    Raises:
        DecodeError: too large, truncated, ill-typed, out of bounds, or an array whose bytes do not fit its shape.
    """
    name = message_type.__name__
    if len(payload) > max_bytes:
        raise DecodeError(f"{name}: {len(payload)} bytes, allowed {max_bytes}")
    try:
        wire = _decoder(message_type).decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, OverflowError) as error:
        raise DecodeError(f"{name}: {error}") from None
    fields = {field: getattr(wire, field) for field in message_type.__struct_fields__}
    for field in _array_fields(message_type):
        if fields[field] is not None:
            fields[field] = _from_wire(f"{name}.{field}", fields[field])
    try:
        return message_type(**fields)
    except ValueError as error:
        raise DecodeError(str(error)) from None


def prepare(message_types: Iterable[type[Message]]) -> None:
    """Make the decoders now; otherwise each is made when its first message comes."""
    for message_type in message_types:
        _decoder(message_type)
        _array_fields(message_type)


def to_builtins(message: msgspec.Struct) -> Any:
    """Message to plain dictionaries and lists, arrays included: for JSON, logs and people."""
    return msgspec.to_builtins(message, enc_hook=_enc_hook_list)


_ENCODER = msgspec.msgpack.Encoder()


@cache
def _array_fields(message_type: type[Message]) -> tuple[str, ...]:
    hints = typing.get_type_hints(message_type)
    return tuple(f for f in message_type.__struct_fields__ if _is_array(hints[f]))


def _is_array(hint: Any) -> bool:
    return hint is np.ndarray or np.ndarray in typing.get_args(hint)


@cache
def _decoder(message_type: type[Message]) -> msgspec.msgpack.Decoder:
    """A decoder for the message's twin in which arrays are WireArray: msgspec then hands out views, not copies."""
    hints = typing.get_type_hints(message_type, include_extras=True)
    fields: list[Any] = []
    for info in msgspec.structs.fields(message_type):
        hint = hints[info.name]
        if _is_array(hint):
            hint = WireArray if hint is np.ndarray else WireArray | None
        if info.name in REQUIRED_ON_WIRE:
            fields.append((info.name, hint))
        elif info.default is not msgspec.NODEFAULT:
            fields.append((info.name, hint, info.default))
        elif info.default_factory is not msgspec.NODEFAULT:
            fields.append((info.name, hint, msgspec.field(default_factory=info.default_factory)))
        else:
            fields.append((info.name, hint))
    twin = msgspec.defstruct(f"{message_type.__name__}Wire", fields, kw_only=True)
    return msgspec.msgpack.Decoder(twin)


def _to_wire(name: str, array: np.ndarray) -> dict[str, Any]:
    array = np.asarray(array)
    if array.dtype == np.bool_:
        array = array.view(np.uint8)
    if array.dtype.byteorder == ">":
        array = array.astype(array.dtype.newbyteorder("<"))
    if array.dtype.str not in ALLOWED_DTYPES:
        raise ValueError(f"{name}: dtype {array.dtype.str} does not travel; allowed {sorted(ALLOWED_DTYPES)}")
    data = np.ascontiguousarray(array)
    return {
        "dtype": data.dtype.str,
        "shape": list(array.shape),
        "data": data.reshape(-1).view(np.uint8).data,
    }


def _from_wire(name: str, wire: WireArray) -> np.ndarray:
    if wire.dtype not in ALLOWED_DTYPES:
        raise DecodeError(f"{name}: dtype {wire.dtype!r}, allowed {sorted(ALLOWED_DTYPES)}")
    dtype = np.dtype(wire.dtype)
    expected = math.prod(wire.shape) * dtype.itemsize
    if expected != wire.data.nbytes:
        raise DecodeError(f"{name}: shape {wire.shape} of {wire.dtype} needs {expected} bytes, got {wire.data.nbytes}")
    try:
        return np.frombuffer(wire.data, dtype=dtype).reshape(wire.shape)
    except ValueError:  # no bytes, but an axis longer than any array may be
        raise DecodeError(f"{name}: {wire.shape} is no shape of an array") from None


def _enc_hook_list(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"cannot show a {type(value).__name__}")
