"""A node on a Zenoh session: what it publishes, and the tokens by which ``ros2 topic list`` and RViz find it."""

from __future__ import annotations

import secrets
import threading
from typing import Any

import zenoh
import zenoh.ext

from common.clock import utc_ns
from common.config import ZenohConfig
from common.ros2.keys import GID_BYTES, Attachment, Entity, Qos, topic_key
from common.ros2.types import to_cdr, type_hash

CDR = zenoh.Encoding("application/cdr")
NODE_ID = 0  # there is one node on each session


def node_config(endpoints: tuple[str, ...]) -> ZenohConfig:
    """Of a node's session: no namespace, and Zenoh's stamps, which its cache for late joiners (/tf_static) needs."""
    return ZenohConfig(namespace="", connect=endpoints, extra={"timestamping/enabled": True})


class Node:
    """One node of a domain; its session has no namespace. It is there until the session is closed."""

    def __init__(self, session: zenoh.Session, name: str, domain: int = 0) -> None:
        self.session, self.name, self.domain = session, name, domain
        self._session_id = str(session.info.zid())
        self._entities = 0
        self._lock = threading.Lock()
        node = Entity(domain, self._session_id, NODE_ID, NODE_ID, "NN", "/", name)
        self._tokens = [session.liveliness().declare_token(str(node))]

    def announce(self, kind: Any, topic: str, type_: str, qos: Qos) -> None:
        """Declare the token for a topic that this node publishes ("MP") or subscribes to ("MS")."""
        with self._lock:
            self._entities += 1
            entity = Entity(
                self.domain, self._session_id, NODE_ID, self._entities, kind, "/", self.name,
                topic, type_, type_hash(type_), str(qos),
            )  # fmt: skip
            self._tokens.append(self.session.liveliness().declare_token(str(entity)))

    def publisher(self, topic: str, type_: str, qos: Qos) -> RosPublisher:
        """Publishes messages of one type; see ``RosPublisher``."""
        self.announce("MP", topic, type_, qos)
        return RosPublisher(self, topic, type_, qos)


class RosPublisher:
    """Call it with a message of its type: CDR with the attachment that rmw_zenoh expects.

    Nothing is kept for a slow reader: congestion drops, as everywhere on a bus of measurements.
    """

    def __init__(self, node: Node, topic: str, type_: str, qos: Qos) -> None:
        self.type, self._node = type_, node  # the node is kept: its tokens go with it
        self._gid = secrets.token_bytes(GID_BYTES)  # rmw_zenoh makes a hash of the token of it; readers compare it only
        self._sequence = 0
        settings: dict[str, Any] = {"encoding": CDR, "congestion_control": zenoh.CongestionControl.DROP}
        self._out: Any
        session, key = node.session, topic_key(node.domain, topic, type_, type_hash(type_))
        if qos.transient_local:
            cache = zenoh.ext.CacheConfig(qos.depth)
            self._out = zenoh.ext.declare_advanced_publisher(
                session, key, cache=cache, publisher_detection=True, **settings
            )
        else:
            self._out = session.declare_publisher(key, **settings)

    def __call__(self, message: Any) -> None:
        if message.__msgtype__ != self.type:
            raise TypeError(f"carries {self.type}, got {message.__msgtype__}")
        self._sequence += 1
        self._out.put(to_cdr(message), attachment=bytes(Attachment(self._sequence, utc_ns(), self._gid)))

    @property
    def wanted(self) -> bool:
        """True while there is a subscriber."""
        status: Any = getattr(self._out, "matching_status", None)  # an advanced publisher does not know
        return status is None or bool(status.matching)
