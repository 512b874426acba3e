"""Which keys are published by services that are alive, and what to say when nothing comes on a key."""

from __future__ import annotations

import difflib

import zenoh

from common import topics

QUERY_TIMEOUT_S = 1.0


def why_silent(session: zenoh.Session, key: str) -> str | None:
    """One sentence when no living service publishes ``key``; None when one does, and just has no data."""
    keys = published_keys(session)
    wanted = zenoh.KeyExpr(key)
    if any(wanted.intersects(known) for known in keys):
        return None
    if not keys:
        return f"nobody publishes {key}: no service is alive on this router"
    near = difflib.get_close_matches(key, keys, n=1, cutoff=0.4)
    hint = (
        f"; did you mean {near[0]}?" if near else f"; alive: {', '.join(sorted({k.rsplit('/', 1)[0] for k in keys}))}"
    )
    return f"nobody publishes {key}{hint}"


def published_keys(session: zenoh.Session) -> list[str]:
    """Every key that a service with a liveliness token publishes, now or on demand."""
    keys: set[str] = set()
    for reply in session.liveliness().get(topics.ANY_TOKEN, timeout=QUERY_TIMEOUT_S):
        if reply.ok is None:
            continue
        host, service, _ = topics.parse_token(str(reply.ok.key_expr))
        keys |= {topic.key(host) for topic in (*topics.DATA_TOPICS, *topics.RAW_TOPICS) if topic.service == service}
        keys.add(topics.status_topic(service).key(host))
    return sorted(keys)
