"""The default namespace of a tool: the site's, or the demo's if only a demo runs."""

from __future__ import annotations

import msgspec

from common import topics
from common.bus.session import close_session, open_session
from common.config import ZenohConfig

SITE = "spotter"  # the default of site.toml
DEMO = "demo"  # a demo has its own namespace, so that its data are never under a site's keys
ANSWER_S = 1.0


def settled(config: ZenohConfig, give_up_after_s: float) -> ZenohConfig:
    """The configuration with ``SITE`` for an empty namespace, or with ``DEMO`` if services are alive there only.

    Raises:
        ConfigError: settings that Zenoh refuses.
        ConnectionError: no router answers.
    """
    if config.namespace:
        return config
    names = {name: msgspec.structs.replace(config, namespace=name) for name in (SITE, DEMO)}
    for name in (SITE, DEMO):
        session = open_session(names[name], give_up_after_s=give_up_after_s)
        try:
            if any(reply.ok for reply in session.liveliness().get(topics.ANY_TOKEN, timeout=ANSWER_S)):
                return names[name]
        finally:
            close_session(session)
    return names[SITE]
