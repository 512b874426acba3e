"""What `look` makes of a source that fails in a way that nobody has foreseen."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from common.bus.look import collect
from common.bus.status import Report


def broken(_: Report) -> Iterator[int]:
    yield 1
    raise RuntimeError("the driver has no such register")


def test_an_unforeseen_error_of_a_source_is_not_taken_for_silence() -> None:
    with pytest.raises(RuntimeError, match="no such register"):
        next(collect(broken, 5.0))
