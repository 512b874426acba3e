"""Commands beside the data, with real sessions against real routers: each may be given by whom the table says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from common.bus.session import close_session, open_session
from common.security.names import read_names
from common.security.rules import access_rules, own_commands, questions, spoken_keys
from common.topics import COMMANDS
from services.infra_lidar.calibration.command import command_key

pytestmark = pytest.mark.timeout(60)
OWN = "infra0/infra_lidar/recalibrate"
ACKNOWLEDGE = "jetson0/gate/acknowledge"
FROM_AFAR = ("pi0/blackbox/incidents", "pi0/blackbox/capsule", "pi0/blackbox/save")


@pytest.fixture(scope="module")
def given(yard: Any) -> Iterator[list[str]]:
    """The commands that reached a service; every one is answered."""
    taken: list[str] = []

    def answer(query: zenoh.Query, key: str) -> None:
        taken.append(key)
        with query:
            query.reply(key, b"done")

    kept = [
        yard.clients[key.split("/")[0]].declare_queryable(key, lambda query, key=key: answer(query, key))
        for key in (OWN, ACKNOWLEDGE, *FROM_AFAR)
    ]
    yield taken
    for queryable in kept:
        queryable.undeclare()


def answered(session: zenoh.Session, question: str) -> set[str]:
    replies = session.get(question, timeout=1.0, target=zenoh.QueryTarget.ALL)
    return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}


def test_the_host_itself_may_give_every_command(yard: Any, given: list[str], until: Callable[..., None]) -> None:
    until(lambda: answered(yard.clients["infra0"], OWN) == {OWN})
    until(lambda: answered(yard.clients["jetson0"], ACKNOWLEDGE) == {ACKNOWLEDGE})
    for key in FROM_AFAR:
        until(lambda key=key: answered(yard.clients["pi0"], key) == {key})


@pytest.mark.parametrize("who", ["laptop", "another host", "a host's certificate from outside"])
@pytest.mark.parametrize(("command", "other"), [(OWN, "jetson0"), (ACKNOWLEDGE, "pi0")])
def test_nobody_else_recalibrates_or_acknowledges(
    yard: Any, given: list[str], command: str, other: str, who: str
) -> None:
    host, service, name = command.split("/")
    sessions = {
        "laptop": lambda: yard.laptop(host),
        "another host": lambda: yard.client(other),
        "a host's certificate from outside": lambda: open_session(yard.named(other, host=host)),
    }
    session = sessions[who]()
    given.clear()
    for question in (command, f"{host}/{service}/*", f"*/*/{name}", f"{host}/**", "**"):
        assert command not in answered(session, question), question
    assert command not in given
    close_session(session)


def test_a_laptop_may_ask_for_capsules_and_save_one(yard: Any, given: list[str], until: Callable[..., None]) -> None:
    laptop = yard.laptop()
    for key in FROM_AFAR:
        until(lambda key=key: answered(laptop, key) == {key})
        assert answered(laptop, key.replace("pi0", "*") + "?name=x;part=0") == {key}
    close_session(laptop)


def test_a_laptop_cannot_answer_in_a_service_s_place(yard: Any, given: list[str]) -> None:
    laptop = yard.laptop()
    asked: list[str] = []

    def lie(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        with query:
            query.reply(str(query.key_expr), b"lie")

    kept = [laptop.declare_queryable(key, lie) for key in ("pi0/radar/status", "jetson0/fusion/clock", OWN)]
    for key in ("pi0/radar/status", "jetson0/fusion/clock", OWN):
        assert answered(yard.clients["jetson0"], key) == set()
    assert not asked
    for queryable in kept:
        queryable.undeclare()
    close_session(laptop)


def test_the_table_names_what_the_services_answer() -> None:
    assert command_key("infra0") == OWN


def test_each_command_is_in_the_rules_of_its_host_once(yard: Any) -> None:
    for command in COMMANDS:
        host = yard.site.host_of(command.service)
        key = f"spotter/{host}/{command.service}/{command.name}"
        assert (key in spoken_keys(yard.site, host)) == command.from_afar
        assert (key in own_commands(yard.site, host)) == (not command.from_afar)
        assert any(q.endswith(f"/{command.service}/{command.name}") for q in questions(yard.site)) == command.from_afar
    egress_rules = [
        rule
        for rule in access_rules(yard.site, "infra0", read_names(yard.keys))["rules"]
        if rule["flows"] == ["egress"]
    ]
    assert not [rule["id"] for rule in egress_rules if f"spotter/{OWN}" in rule["key_exprs"]]
