"""What ``echo`` and ``hz`` subscribe to for a key expression.

A subscriber on ``*/*/*`` would match every on-demand topic, and make each camera and lidar send its pictures and
clouds. So an expression whose product is a wildcard selects the periodic topics only; on-demand topics are named.
"""

from __future__ import annotations

from dataclasses import dataclass

import zenoh

from common import topics
from common.bus.session import plain
from spotter_tools.cli.fail import fail

KNOWN = (*topics.DATA_TOPICS, *topics.RAW_TOPICS)


@dataclass(frozen=True)
class Selection:
    """``expressions`` to subscribe to, for the keys that ``wanted`` includes; ``left_out`` on-demand topics."""

    wanted: zenoh.KeyExpr
    expressions: tuple[str, ...]
    left_out: tuple[str, ...]

    def includes(self, key: str) -> bool:
        """Whether a sample of this key was asked for: an expression of the table may be wider."""
        return bool(self.wanted.includes(key))

    @property
    def note(self) -> str:
        """What a person should know before waiting; empty if nothing was left out."""
        if not self.left_out:
            return ""
        return f"on-demand topics are left out, ask for them by name: {', '.join(self.left_out)}"


def key_expression(key: str) -> zenoh.KeyExpr:
    """What Zenoh takes for a key expression; ends the command when it is none."""
    try:
        return zenoh.KeyExpr(key)
    except zenoh.ZError as error:
        fail(f"{key!r} is no key expression: {plain(error)}")


def select(key: str) -> Selection:
    """The selection for a key expression; ends the command when it is none."""
    wanted = key_expression(key)
    if "*" not in key.rsplit("/", 1)[-1]:
        return Selection(wanted, (key,), ())
    matching = [topic for topic in KNOWN if wanted.intersects(topic.any_host)]
    periodic = [topic.any_host for topic in matching if not topic.on_demand]
    if wanted.intersects(topics.status_topic("*").any_host):
        periodic.append(topics.status_topic("*").any_host)
    left_out = tuple(topic.name for topic in matching if topic.on_demand)
    return Selection(wanted, tuple(periodic) or (key,), left_out)
