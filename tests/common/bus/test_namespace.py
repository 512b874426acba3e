"""A tool that is not told where to look takes the site's namespace, and the demo's where only a demo runs."""

from __future__ import annotations

from contextlib import ExitStack

import msgspec
import pytest

from common.bus.namespace import settled
from common.bus.session import open_session
from common.config import ZenohConfig


@pytest.mark.parametrize(
    ("alive", "expected"),
    [((), "spotter"), (("demo",), "demo"), (("spotter",), "spotter"), (("spotter", "demo"), "spotter")],
)
def test_the_site_first_then_the_demo(zenoh_config: ZenohConfig, alive: tuple[str, ...], expected: str) -> None:
    with ExitStack() as stack:
        for name in alive:
            session = stack.enter_context(open_session(msgspec.structs.replace(zenoh_config, namespace=name)))
            stack.enter_context(session.liveliness().declare_token("pi0/radar/alive/x"))
        found = settled(msgspec.structs.replace(zenoh_config, namespace=""), 5.0)
    assert found.namespace == expected


def test_what_is_said_is_taken_without_a_question() -> None:
    said = ZenohConfig(namespace="yard", connect=("tcp/127.0.0.1:1",))
    assert settled(said, 0.5) is said
