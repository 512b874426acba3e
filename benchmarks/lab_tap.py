"""Runs on one host of a lab and prints the messages that it receives as JSON lines.

python -m benchmarks.lab_tap FOLDER HOST                 # verdict and health
python -m benchmarks.lab_tap FOLDER HOST count SECONDS [TOPIC...]  # messages, bytes and delays by key
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import zenoh

from common import topics
from common.bus.session import close_session, open_session
from common.clock import monotonic_s, utc_ns
from common.codec import DecodeError, decode
from common.config import ZenohConfig
from common.host.site import load_site
from common.messages import Message, SystemHealth, Verdict
from common.security.router_config import laptop_config

LAPTOP_AT = "gate0"


def session_on(folder: Path, host: str) -> zenoh.Session:
    """A session like that of a service of this host, or of a laptop at gate0\'s router."""
    site = load_site(folder / "site.toml")
    if host not in site.hosts:
        return open_session(laptop_config(site, host, folder / "keys", LAPTOP_AT))
    return open_session(ZenohConfig(namespace=site.namespace, connect=(site.host(host).loopback,)))


def summary(message: Message) -> dict[str, Any]:
    """The fields of a verdict or a health message that the tests use."""
    if isinstance(message, SystemHealth):
        return {
            "kind": "health",
            "states": {name: one.state for name, one in message.sensors.items()},
            "causes": {name: one.cause for name, one in message.sensors.items()},
            "reasons": {name: one.reason for name, one in message.sensors.items()},
        }
    assert isinstance(message, Verdict)
    used = [name for name, one in message.inputs.items() if one.used]
    return {"kind": "verdict", "level": message.level, "permission": message.permission, "rule": message.rule,
            "used": used}  # fmt: skip


def listen(session: zenoh.Session) -> None:
    """Print every verdict and health message until this process is ended."""
    one_at_a_time = threading.Lock()

    def report(sample: zenoh.Sample) -> None:
        """A line for one message; what cannot be decoded is told too."""
        at_s, topic = monotonic_s(), topics.find_topic(str(sample.key_expr))
        assert topic is not None
        try:
            line = {"at": at_s, **summary(decode(sample.payload.to_bytes(), topic.message))}
        except DecodeError as error:
            line = {"at": at_s, "kind": "undecodable", "why": str(error)}
        with one_at_a_time:
            print(json.dumps(line), flush=True)

    kept = [session.declare_subscriber(t.any_host, report) for t in (topics.FUSION_VERDICT, topics.FUSION_HEALTH)]
    threading.Event().wait()
    del kept


def count(session: zenoh.Session, seconds: float, more: list[str]) -> None:
    """One JSON object: by key the bytes of each message and its transport time in ms."""
    seen: dict[str, dict[str, list[float]]] = {}

    def note(sample: zenoh.Sample) -> None:
        now_ns, payload = utc_ns(), sample.payload.to_bytes()
        one = seen.setdefault(str(sample.key_expr), {"bytes": [], "ms": []})
        one["bytes"].append(len(payload))
        topic = topics.find_topic(str(sample.key_expr))
        if topic is not None and not topic.is_large:
            one["ms"].append((now_ns - decode(payload, topic.message).sent_ns) * 1e-6)

    wanted = [t for t in topics.DATA_TOPICS if not t.on_demand or t.name in more]
    kept = [session.declare_subscriber(topic.any_host, note) for topic in [*wanted, topics.status_topic("*")]]
    time.sleep(seconds)
    print(json.dumps(seen), flush=True)
    del kept


def main() -> None:
    """The commands above."""
    session = session_on(Path(sys.argv[1]), sys.argv[2])
    match sys.argv[3:]:
        case ["count", seconds, *more]:
            count(session, float(seconds), more)
        case _:
            listen(session)
    close_session(session)


if __name__ == "__main__":
    main()
