"""Who publishes what in a ROS domain, by the liveliness tokens of rmw_zenoh."""

from __future__ import annotations

import threading

import zenoh

from common.ros2.keys import Entity, entity_of, publishers_key
from common.ros2.source import RosTopic

NAMED = 5  # topics that are named where ours is not there


class Graph:
    """Follows the publishers of a domain."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._publishers: dict[str, Entity] = {}
        self._lock = threading.Lock()
        self._subscriber = session.liveliness().declare_subscriber(publishers_key(domain), self._change, history=True)

    def publishers(self) -> list[Entity]:
        """All of them, in the order of their topics."""
        with self._lock:
            return sorted(self._publishers.values(), key=lambda one: (one.topic, one.full_node))

    def why_silent(self, topic: RosTopic, hash_: str) -> str:
        """Why nothing of a topic comes, in words that follow its name."""
        everyone = self.publishers()
        ours = [one for one in everyone if one.topic == topic.name]
        others = sorted({one.topic for one in everyone} - {topic.name})
        if not ours:
            seen = f"; there: {', '.join(others[:NAMED])}{' ...' if len(others) > NAMED else ''}" if others else ""
            hint = "" if others else " (is its router the one that is asked, and do its rules let ROS through?)"
            return f"nobody publishes it in domain {topic.domain}{seen}{hint}"
        fitting = [one for one in ours if one.type_ == topic.type]
        if not fitting:
            return f"is {ours[0].type_} of node {ours[0].full_node}, expected {topic.type}"
        same = [one for one in fitting if one.hash_ == hash_ or topic.any_hash]
        if not same:
            return (
                f"node {fitting[0].full_node} has another definition of {topic.type} ({fitting[0].hash_[:15]}) than "
                f"ours ({hash_[:15]}): another ROS distribution? ?hash=any takes it as it is"
            )
        return f"node {same[0].full_node} publishes it but sends nothing; check the sensor behind it"

    def _change(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        entity = entity_of(token)
        with self._lock:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._publishers.pop(token, None)
            elif entity is not None:
                self._publishers[token] = entity
