"""Names of rmw_zenoh on a Zenoh network: topics, liveliness tokens, quality of service, attachments. Pure.

The format is that of rmw_zenoh's design document (docs/design.md, "Topic and Service name mapping", "Graph Cache",
"Publishers"), of Jazzy and later; the attachment is the one since release 0.6. A topic is
``<domain>/<topic>/<type>/<hash>``. A name within a token has ``%`` for every ``/``.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Literal

ADMIN_SPACE = "@ros2_lv"
GID_BYTES = 16
_ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")
_TOPIC_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/(?:msg/)?([A-Za-z][A-Za-z0-9_]*)")

Kind = Literal["NN", "MP", "MS", "SS", "SC"]  # node, publisher, subscription, service, client


class RosNameError(ValueError):
    """No name of ROS 2; the text says what is expected."""


def topic_name(text: str) -> str:
    """A topic with its leading slash.

    Raises:
        RosNameError: not a topic's name.
    """
    name = "/" + text.strip("/")
    if not _TOPIC_NAME.fullmatch(name):
        raise RosNameError(f"{text!r} is no topic's name: expected /name/name of letters, digits and _, no digit first")
    return name


def type_name(text: str) -> str:
    """``package/msg/Type``; the short ``package/Type`` is taken as well.

    Raises:
        RosNameError: not a message type's name.
    """
    match = _TYPE_NAME.fullmatch(text)
    if match is None:
        raise RosNameError(f"{text!r} is no message type: expected package/msg/Type")
    return f"{match[1]}/msg/{match[2]}"


def dds_name(name: str) -> str:
    """``std_msgs/msg/String`` as it stands in keys: ``std_msgs::msg::dds_::String_``."""
    package, middle, last = name.split("/")
    return f"{package}::{middle}::dds_::{last}_"


def name_of_dds(dds: str) -> str:
    """The way back; what is no such name is given back as it is."""
    package, _, last = dds.partition("::dds_::")
    return f"{package.replace('::', '/')}/{last.removesuffix('_')}" if last else dds


def topic_key(domain: int, topic: str, type_: str = "*", hash_: str = "*") -> str:
    """The key of a topic, ``topic`` with its leading slash; without type and hash the expression for all of them."""
    return f"{domain}{topic}/{type_ if type_ == '*' else dds_name(type_)}/{hash_}"


def type_and_hash(key: str) -> tuple[str, str]:
    """Type name and hash at the end of a topic's key."""
    *_, dds, hash_ = key.split("/")
    return name_of_dds(dds), hash_


def mangled(name: str) -> str:
    """A name as one chunk of a token."""
    return name.replace("/", "%") or "%"


@dataclass(frozen=True)
class Qos:
    """What of a quality of service matters on Zenoh; the defaults are ROS 2's own."""

    reliable: bool = True
    transient_local: bool = False  # the last ``depth`` messages are kept for those who come later
    depth: int = 10

    def __str__(self) -> str:
        """As in a token: only what differs from the defaults is written; deadline and the like are left at theirs."""
        return f"{'' if self.reliable else 2}:{1 if self.transient_local else ''}:,{self.depth}:,:,:,,"


SENSOR_DATA = Qos(reliable=False, depth=5)


@dataclass(frozen=True)
class Entity:
    """An entity in the graph of ROS 2, read from its token. ``topic``, ``type_``, ``hash_``: "" of a node."""

    domain: int
    session: str
    node_id: int
    entity_id: int
    kind: Kind
    namespace: str
    node: str
    topic: str = ""
    type_: str = ""
    hash_: str = ""
    qos: str = ""

    @property
    def full_node(self) -> str:
        """The node with its namespace, as ``ros2 node list`` has it."""
        return f"{self.namespace.rstrip('/')}/{self.node}"

    def __str__(self) -> str:
        """The key of its liveliness token."""
        namespace = mangled(self.namespace)
        token = f"{ADMIN_SPACE}/{self.domain}/{self.session}/{self.node_id}/{self.entity_id}/{self.kind}/%/{namespace}"
        token += f"/{self.node}"
        if self.kind != "NN":
            token += f"/{mangled(self.topic)}/{dds_name(self.type_)}/{self.hash_}/{self.qos}"
        return token


def entity_of(token: str) -> Entity | None:
    """Parse a liveliness token; None if it is not from ROS 2. Additional fields are ignored."""
    parts = token.split("/")
    if (
        parts[0] != ADMIN_SPACE
        or len(parts) not in (9, *range(13, 17))
        or parts[5] not in ("NN", "MP", "MS", "SS", "SC")
    ):
        return None
    try:
        domain, node_id, entity_id = int(parts[1]), int(parts[3]), int(parts[4])
    except ValueError:
        return None
    namespace = parts[7].replace("%", "/")
    node = Entity(domain, parts[2], node_id, entity_id, parts[5], namespace, parts[8].replace("%", "/"))  # type: ignore[arg-type]
    if len(parts) == 9:
        return node if node.kind == "NN" else None
    topic, type_ = parts[9].replace("%", "/"), name_of_dds(parts[10])
    return Entity(domain, parts[2], node_id, entity_id, node.kind, namespace, node.node, topic, type_, *parts[11:13])


def publishers_key(domain: int) -> str:
    """The expression for the tokens of all publishers of a domain."""
    return f"{ADMIN_SPACE}/{domain}/*/*/*/MP/**"


@dataclass(frozen=True)
class Attachment:
    """What travels beside each message.

    sequence: of this publisher, from 1. sent_ns: UTC ns at which it was published. gid: the publisher's own 16 bytes.
    """

    sequence: int
    sent_ns: int
    gid: bytes

    def __bytes__(self) -> bytes:
        return _ATTACHMENT.pack(self.sequence, self.sent_ns, GID_BYTES, self.gid)


def attachment_of(data: bytes) -> Attachment | None:
    """None if it is none, or one of a release before 0.6."""
    if len(data) != _ATTACHMENT.size or data[16] != GID_BYTES:
        return None
    sequence, sent_ns, _, gid = _ATTACHMENT.unpack(data)
    return Attachment(sequence, sent_ns, gid)
