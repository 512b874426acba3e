"""``ros2:/topic?type=package/msg/Type&domain=0``: the address of a topic as a source of a service. Pure.

========================  =======================================================================================
``type=``                 the message type; without it the service's first one
``domain=0``              the ROS domain
``connect=tcp/HOST:7447``  the ROS machine's router; without it the router of this host
``stamp=arrival``         date by arrival instead of ``header.stamp``
``kind=simulated``        what is published is made up, or ``recorded``: it is never shown as live
``hash=any``              take another definition of the type as it is (Humble has no hashes)
========================  =======================================================================================
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import msgspec

from common.config import ConfigError, ZenohConfig
from common.ros2.keys import RosNameError, topic_name, type_name
from common.ros2.stamps import By
from common.source_url import SourceUrl

ROS2_PARAMETERS = ("type", "domain", "connect", "stamp", "hash", "kind")
KINDS = ("live", "recorded", "emulated", "simulated")


@dataclass(frozen=True)
class RosTopic:
    """A topic to listen to. any_hash: other definitions of the type are taken too."""

    name: str
    type: str
    domain: int = 0
    stamp: By = "header"
    any_hash: bool = False


def require_rosbags(url: SourceUrl) -> None:
    """Before anything that needs it is loaded. Raises ``ConfigError`` when the extra is not installed."""
    if importlib.util.find_spec("rosbags") is None:
        raise ConfigError(f"source {url}: library rosbags is missing: install the extra ros2")


def ros_topic(url: SourceUrl, types: Sequence[str]) -> RosTopic:
    """The topic of a source; ``types`` are those that the service reads, the first without ``type=``.

    Raises:
        ConfigError: not a topic's name, a type that the service does not read, or a wrong parameter.
    """
    try:
        name, wanted = topic_name(url.target), type_name(url.params.get("type", types[0]))
    except RosNameError as error:
        raise ConfigError(f"source {url}: {error}") from None
    if wanted not in types:
        raise ConfigError(f"source {url}: type {wanted} is not read here; allowed: {', '.join(types)}")
    domain = url.number("domain", 0.0)
    if not (domain.is_integer() and 0 <= domain <= 232):
        raise ConfigError(f"source {url}: domain={url.params['domain']}: expected 0 to 232")
    stamp, hash_ = url.params.get("stamp", "header"), url.params.get("hash", "same")
    kind = url.params.get("kind", "live")
    if kind not in KINDS:
        raise ConfigError(f"source {url}: kind={kind}: expected {', '.join(KINDS)}")
    if stamp not in ("header", "arrival"):
        raise ConfigError(f"source {url}: stamp={stamp}: expected header or arrival")
    if hash_ not in ("same", "any"):
        raise ConfigError(f"source {url}: hash={hash_}: expected same or any")
    return RosTopic(name, wanted, int(domain), cast(By, stamp), hash_ == "any")


def ros_session(url: SourceUrl, zenoh: ZenohConfig) -> ZenohConfig:
    """How the topic is reached: a session of its own, because ROS topics stand outside of the site's namespace."""
    if "connect" not in url.params:
        return msgspec.structs.replace(zenoh, namespace="")
    return ZenohConfig(namespace="", connect=(url.params["connect"],), lease_ms=zenoh.lease_ms)
