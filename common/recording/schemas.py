"""JSON schemas of the messages, for readers of a recording that do not have this package."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import msgspec
import numpy as np

from common.messages import Message

_ARRAY_SCHEMA = {
    "type": "object",
    "title": "array",
    "description": 'A numeric array: {"dtype": "<f4", "shape": [n, 3], "data": <bytes, row by row>}.',
    "required": ["dtype", "shape", "data"],
    "properties": {
        "dtype": {"type": "string"},
        "shape": {"type": "array", "items": {"type": "integer", "minimum": 0}},
        "data": {"type": "string", "contentEncoding": "base64"},
    },
}


def schema_name(message_type: type[Message]) -> str:
    """``spotter.Verdict.v1``: the same name as in the Zenoh encoding."""
    return f"spotter.{message_type.__name__}.v1"


@cache
def json_schema(message_type: type[Message]) -> bytes:
    """The message's JSON schema as UTF-8 text."""
    schema = msgspec.json.schema(message_type, schema_hook=_hook)
    return json.dumps(schema, sort_keys=True).encode()


def _hook(kind: type) -> dict[str, Any]:
    if kind is np.ndarray:
        return _ARRAY_SCHEMA
    if kind is object:
        return {"description": "any value"}
    raise NotImplementedError(f"no schema for {kind}")
