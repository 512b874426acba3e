"""Writes small ONNX files by hand, so that the tests need no package for it: protobuf with the fields that are used.

Field numbers: onnx.proto of the ONNX project.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FLOAT, UINT8, FLOAT16 = 1, 2, 10  # TensorProto.DataType
_TYPES = {"float32": FLOAT, "uint8": UINT8, "float16": FLOAT16}
_INT = 2  # AttributeProto.AttributeType


class Port(NamedTuple):
    """An input or an output; an axis with a name has a free size."""

    name: str
    kind: int
    shape: tuple[int | str, ...]


def constant_network(
    image: Port,
    outputs: list[np.ndarray],
    metadata: dict[str, str],
    declared: list[tuple[int | str, ...]] | None = None,
) -> bytes:
    """A network that gives ``outputs`` for every picture: constant + 0 x mean of the input."""
    nodes = [
        _node("Cast", [image.name], ["picture"], to=FLOAT),
        _node("ReduceMean", ["picture"], ["mean"], keepdims=0),
        _node("Mul", ["mean", "zero"], ["nothing"]),
    ]
    tensors, ports = [_tensor("zero", np.float32(0.0))], []
    for number, output in enumerate(outputs):
        kind = _TYPES[output.dtype.name]
        nodes.append(_node("Cast", ["nothing"], [f"nothing{number}"], to=kind))
        nodes.append(_node("Add", [f"constant{number}", f"nothing{number}"], [f"output{number}"]))
        tensors.append(_tensor(f"constant{number}", output))
        ports.append(Port(f"output{number}", kind, declared[number] if declared else output.shape))
    graph = b"".join(_field(1, node) for node in nodes) + _field(2, b"test")
    graph += b"".join(_field(5, tensor) for tensor in tensors) + _field(11, _value_info(image))
    graph += b"".join(_field(12, _value_info(port)) for port in ports)
    model = _number(1, 8) + _field(7, graph) + _field(8, _field(1, b"") + _number(2, 13))
    return model + b"".join(
        _field(14, _field(1, key.encode()) + _field(2, text.encode())) for key, text in metadata.items()
    )


def _node(kind: str, inputs: list[str], outputs: list[str], **attributes: int) -> bytes:
    body = b"".join(_field(1, name.encode()) for name in inputs) + b"".join(_field(2, o.encode()) for o in outputs)
    body += _field(4, kind.encode())
    for name, value in attributes.items():
        body += _field(5, _field(1, name.encode()) + _number(3, value) + _number(20, _INT))
    return body


def _tensor(name: str, values: np.ndarray | np.float32) -> bytes:
    array = np.asarray(values)
    dims = b"".join(_number(1, size) for size in array.shape)
    return dims + _number(2, _TYPES[array.dtype.name]) + _field(8, name.encode()) + _field(9, array.tobytes())


def _value_info(port: Port) -> bytes:
    dims = b"".join(
        _field(1, _number(1, size) if isinstance(size, int) else _field(2, size.encode())) for size in port.shape
    )
    return _field(1, port.name.encode()) + _field(2, _field(1, _number(1, port.kind) + _field(2, dims)))


def _field(number: int, payload: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(payload)) + payload


def _number(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*parts, value])
