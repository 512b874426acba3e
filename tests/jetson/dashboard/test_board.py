"""The board: newest values with their ages, histories of changes, pictures apart."""

from __future__ import annotations

import json

import msgspec
import pytest

from common.messages import CompressedImage, SensorHealth, SystemHealth, Verdict
from services.jetson.dashboard.board import HISTORY, PICTURES, Board
from services.jetson.dashboard.server import Wish, parse_wish


def verdict(level: str = "SAFE", rule: str = "R0", stamp_ns: int = 1) -> Verdict:
    return Verdict(
        stamp_ns=stamp_ns, level=level, rule=rule, because="test", inputs={}, confirmed=False,  # type: ignore[arg-type]
        suppressed=False, advisory=None, blind=False, permission="GO",
    )  # fmt: skip


def health(state: str) -> SystemHealth:
    sensor = SensorHealth(state=state, reason="why", since_ns=0, age_ms=1.0, rate_hz=10.0)  # type: ignore[arg-type]
    return SystemHealth(stamp_ns=1, sensors={"lidar": sensor}, colour="green", summary="", services={})


def test_ages_grow_and_the_newest_counts() -> None:
    board = Board()
    board.put("jetson0/fusion/verdict", verdict("SAFE"), arrived_s=10.0)
    board.put("jetson0/fusion/verdict", verdict("CAUTION"), arrived_s=11.0)
    entry = json.loads(board.snapshot(11.5, 7, {"*"}))["entries"]["jetson0/fusion/verdict"]
    assert entry["age_ms"] == 500.0
    assert entry["message"]["level"] == "CAUTION"


def test_only_changes_enter_the_histories() -> None:
    board = Board()
    for level in ("SAFE", "SAFE", "CAUTION", "CAUTION", "SAFE"):
        board.put("jetson0/fusion/verdict", verdict(level), 0.0)
    for state in ("online", "online", "degraded", "online"):
        board.put("jetson0/fusion/health", health(state), 0.0)
    snapshot = json.loads(board.snapshot(0.0, 7, {"*"}))
    assert snapshot["stamp_ns"] == 7
    assert [row["level"] for row in snapshot["verdicts"]] == ["SAFE", "CAUTION", "SAFE"]
    assert [row["state"] for row in snapshot["healths"]] == ["online", "degraded", "online"]


def test_histories_are_bounded() -> None:
    board = Board()
    for i in range(3 * HISTORY):
        board.put("jetson0/fusion/verdict", verdict("SAFE", rule=f"R{i}"), 0.0)
    assert len(board._verdicts) == HISTORY


def test_a_picture_is_not_in_the_snapshot_but_beside_it() -> None:
    board = Board()
    image = CompressedImage(stamp_ns=5, seq=3, format="jpeg", data=b"\xff\xd8" * 1000, captions=["car 5.2 m"])
    board.put("jetson0/camera/image", image, 0.0)
    snapshot = board.snapshot(0.0, 7, {"*"})
    assert len(snapshot) < 500
    message = json.loads(snapshot)["entries"]["jetson0/camera/image"]["message"]
    assert (message["seq"], message["captions"], "data" in message) == (3, ["car 5.2 m"], False)
    assert board.image("jetson0/camera/image") == image.data
    assert board.image("jetson1/camera/image") is None


def test_a_picture_comes_by_its_stamp_or_not_at_all() -> None:
    """The address has every digit of the stamp: a number of JavaScript would lose the last ones."""
    board, first_ns = Board(), 1_764_098_400_123_456_789
    for turn in range(2 * PICTURES):
        image = CompressedImage(stamp_ns=first_ns + turn, format="jpeg", data=b"%d" % turn)
        board.put("jetson0/camera/image", image, 0.0)
    message = json.loads(board.snapshot(0.0, 7, {"camera/image"}))["entries"]["jetson0/camera/image"]["message"]
    assert message["address"] == f"/api/image/jetson0?stamp={first_ns + 2 * PICTURES - 1}"
    kept = {ago: board.image("jetson0/camera/image", first_ns + 2 * PICTURES - 1 - ago) for ago in (0, 1, PICTURES)}
    assert kept == {0: b"%d" % (2 * PICTURES - 1), 1: b"%d" % (2 * PICTURES - 2), PICTURES: None}


def test_a_client_gets_what_it_asked_for_and_always_the_verdict() -> None:
    board = Board()
    board.put("jetson0/fusion/verdict", verdict(), 0.0)
    board.put("jetson0/camera/image", CompressedImage(stamp_ns=5, format="jpeg", data=b""), 0.0)
    assert set(json.loads(board.snapshot(0.0, 7, {"radar/tracks"}))["entries"]) == {"jetson0/fusion/verdict"}


def test_a_message_that_is_no_json_costs_nobody_the_others(caplog: pytest.LogCaptureFixture) -> None:
    """Some fields are free-form: msgpack has keys and types that JSON has not."""
    board = Board()
    board.put("jetson0/fusion/health", health("online"), 0.0)
    for odd in ({(1,): 1}, {"a": msgspec.msgpack.Ext(5, b"")}, {None: 1}):
        message = verdict()
        message.deciding = {"odd": odd}
        board.put("jetson0/fusion/verdict", message, 0.0)
        assert set(json.loads(board.snapshot(0.0, 7, {"*"}))["entries"]) == {"jetson0/fusion/health"}
    assert [record.getMessage()[:50] for record in caplog.records] == [
        "jetson0/fusion/verdict cannot be shown as JSON: On"
    ]


def test_wishes_are_bounded_and_nonsense_is_the_default() -> None:
    assert parse_wish('{"rate_hz": 1000, "products": ["a"]}', 20.0) == Wish(20.0, frozenset({"a"}))
    assert parse_wish('{"rate_hz": 0.001}', 20.0).rate_hz == 0.1
    for nonsense in (
        "",
        "[]",
        "3",
        '{"rate_hz": "x"}',
        '{"rate_hz": NaN}',
        '{"products": 3}',
        "\u0000",
        '{"rate_hz": 1%s}' % ("0" * 400),
        "[" * 100_000,
    ):
        assert parse_wish(nonsense, 20.0).rate_hz == 5.0, nonsense
