"""The table is consistent: keys, owners, tokens."""

from __future__ import annotations

import pytest

from common import topics
from common.messages import ServiceStatus
from common.topics import DATA_TOPICS, OPTIONAL_SERVICES, SERVICES


def test_names_are_unique() -> None:
    assert len({topic.name for topic in DATA_TOPICS}) == len(DATA_TOPICS)
    assert len({row.name for row in SERVICES + OPTIONAL_SERVICES}) == len(SERVICES) + len(OPTIONAL_SERVICES)


def test_every_topic_is_owned_by_a_service() -> None:
    owners = {row.name for row in SERVICES + OPTIONAL_SERVICES}
    assert {topic.service for topic in DATA_TOPICS} <= owners


def test_the_sensors_are_named_by_their_role_in_the_order_of_the_health_bar() -> None:
    assert topics.ONBOARD_SENSORS[:3] == ("lidar", "radar", "camera")
    assert "infra_lidar" not in topics.ONBOARD_SENSORS
    assert set(topics.SENSOR_TOPICS) - set(topics.ONBOARD_SENSORS) == {"infra_lidar"}


def test_every_sensor_has_one_topic_for_fusion_with_an_age_limit() -> None:
    deciding = [topic for topic in DATA_TOPICS if topic.role is not None]
    assert len({topic.service for topic in deciding}) == len(deciding)
    assert all(topic.age_limit_s is not None for topic in deciding)


def test_large_topics_never_outrank_small_ones() -> None:
    for topic in DATA_TOPICS:
        assert (topic.congestion == "block_first") == topic.is_large, topic.name


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("pi0/radar/tracks", topics.RADAR_TRACKS),
        ("any/fusion/verdict", topics.FUSION_VERDICT),
        ("pi0/radar/info", None),
        ("pi0/radar", None),
        ("pi0/radar/alive/1", None),
        ("/recorder/status", None),  # of a recording, not of the bus
    ],
)
def test_find_topic(key: str, expected: topics.Topic | None) -> None:
    assert topics.find_topic(key) == expected


def test_status_is_found_for_any_service() -> None:
    found = topics.find_topic("pi0/somebody_elses/status")
    assert found is not None
    assert found.message is ServiceStatus


def test_tokens_parse_back() -> None:
    assert topics.parse_token(topics.token_key("pi0", "radar", "ab12")) == ("pi0", "radar", "ab12")
    with pytest.raises(ValueError, match="not a liveliness token"):
        topics.parse_token("pi0/radar/tracks")


def test_scripts_follow_the_names() -> None:
    assert topics.service_row("infra_lidar").script == "spotter-infra-lidar"
    with pytest.raises(KeyError, match="known: radar, lidar"):
        topics.service_row("sonar")
