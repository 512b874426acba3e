"""Messages one after the other, from the bus or from a recording, and as a table of pandas or polars."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any, Generic, TypeVar

from common.codec import to_builtins
from common.messages import Message

M = TypeVar("M", bound=Message)


class Stream(Generic[M]):
    """Iterate it, or turn what is left of it into a table.

    A table has a row a message. Nested fields have dotted names (``inputs.lidar.age_ms``), lists stay lists; ``time``
    is ``stamp_ns`` as a time of UTC, ``key`` where the message came from. ``each="tracks"`` makes a row of every track
    instead, with the fields of its message repeated; messages without tracks then have no row.
    """

    def __init__(self, messages: Iterator[tuple[str, M]]) -> None:
        self._messages = messages

    def __iter__(self) -> Iterator[M]:
        return self

    def __next__(self) -> M:
        return next(self._messages)[1]

    def to_pandas(self, each: str = "") -> Any:
        """``pandas.DataFrame``. Waits for the end of the stream: give it ``seconds`` or ``count``.

        Raises:
            ImportError: pandas is not installed.
            KeyError: a message has no list of the name ``each``.
        """
        pandas = _library("pandas")
        table = pandas.DataFrame(self._columns(each))
        if len(table):
            table.insert(0, "time", pandas.to_datetime(table["stamp_ns"], unit="ns", utc=True))
        return table

    def to_polars(self, each: str = "") -> Any:
        """``polars.DataFrame``; otherwise as ``to_pandas``."""
        polars = _library("polars")
        table = polars.DataFrame(self._columns(each), strict=False)
        if not len(table):
            return table
        time = polars.from_epoch(polars.col("stamp_ns"), "ns").dt.replace_time_zone("UTC").alias("time")
        return table.select(time, polars.all())

    def _columns(self, each: str) -> dict[str, list[Any]]:
        rows = [row for key, message in self._messages for row in _rows(key, message, each)]
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: [row.get(name) for row in rows] for name in names}


def _rows(key: str, message: Message, each: str) -> Iterator[dict[str, Any]]:
    content = to_builtins(message)
    if not each:
        yield {"key": key, **_flat(content)}
        return
    if not isinstance(content.get(each), list):
        lists = ", ".join(name for name, value in content.items() if isinstance(value, list)) or "none"
        raise KeyError(f"{type(message).__name__} on {key} has no list {each!r}; it has {lists}")
    of_message = {name: value for name, value in content.items() if not isinstance(value, list)}
    for one in content[each]:
        yield {"key": key, **_flat(of_message), **_flat({each: one})}


def _flat(content: dict[str, Any], above: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in content.items():
        flat |= _flat(value, f"{above}{name}.") if isinstance(value, dict) else {f"{above}{name}": value}
    return flat


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ImportError(f"this needs {name}, which is not installed: pip install {name}") from None
