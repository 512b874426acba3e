"""What came in a period, however late this process itself is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from common.bus.look import collect
from common.bus.status import Report


def test_what_is_there_is_seen_in_a_period_that_is_over_at_once() -> None:
    seen = list(collect(lambda report: ["a", "b"], 1e-9))
    assert [item for one in seen for item in one.items] == ["a", "b"]
    assert seen[0].items == ["a"]


def test_an_error_of_the_source_comes_after_what_it_gave() -> None:
    def items(report: Report) -> Iterator[int]:
        yield from range(5)
        raise OSError("pulled out")

    got: list[int] = []
    with pytest.raises(OSError, match="pulled out"):
        got.extend(item for seen in collect(items, 1e-9) for item in seen.items)
    assert got == [0, 1, 2, 3, 4]
