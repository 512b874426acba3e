"""What a command says when it is given something that cannot be: one sentence, never a traceback."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from spotter_tools.cli import fail
from spotter_tools.cli.__main__ import app

runner = CliRunner()
PROTOCOLS = "protocols are tcp, tls, udp, quic, ws, unixsock-stream, unixpipe, serial, vsock"
ENDPOINT = "expected PROTOCOL/HOST:PORT, e.g. tcp/127.0.0.1:7447"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["ls", "--connect", "foo"], 1, f"[zenoh] endpoint 'foo': {ENDPOINT}; {PROTOCOLS}"),
        (["ls", "--connect", "tpc/10.0.0.1:7447"], 1, f"[zenoh] endpoint 'tpc/10.0.0.1:7447': {ENDPOINT}; {PROTOCOLS}"),
        (
            ["echo", "x", "--connect", "tcp/10.0.0.1"],
            1,
            f"[zenoh] endpoint 'tcp/10.0.0.1': {ENDPOINT}; its port is missing",
        ),
        (
            ["ls", "--connect", "tcp/127.0.0.1:99999"],
            1,
            f"[zenoh] endpoint 'tcp/127.0.0.1:99999': {ENDPOINT}; ports are 1 to 65535",
        ),
        (
            ["demo", "--listen", "tcp/127.0.0.1"],
            2,
            f"[zenoh] endpoint 'tcp/127.0.0.1': {ENDPOINT}; its port is missing",
        ),
        (
            ["demo", "--listen", "tcp/127.0.0.1:0"],
            2,
            f"[zenoh] endpoint 'tcp/127.0.0.1:0': {ENDPOINT}; ports are 1 to 65535",
        ),
        (["demo", "--listen", "bogus"], 2, f"'bogus' is no endpoint: {ENDPOINT}"),
        (
            ["demo", "--scenario", "nowhere"],
            2,
            "radar: source sim:nowhere: no scenario 'nowhere'; known: crossing, empty, faults, drive, emergency",
        ),
        (
            ["swap", "radar", "--candidate", "it's"],
            2,
            """--candidate "it's": expected a command, no closing quotation""",
        ),
        (["swap", "radar", "--candidate", " "], 2, "--candidate ' ': expected a command, found none"),
        (["up", "mars"], 2, "no services on host 'mars'; known hosts: infra0, jetson0, pi0"),
    ],
)
def test_a_place_that_cannot_be(words: list[str], code: int, said: str) -> None:
    refused = runner.invoke(app, words)
    assert (refused.exit_code, refused.output) == (code, f"spotter: {said}\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["health", "--fusion-host", "a//"], "expected the name of a host"),
        (["metrics", "--host", "a//"], "expected the name of a host"),
        (["record", "--host", "a//b"], "'a//b': expected a name of a-z, 0-9 and _"),
        (["swap", "radar", "--candidate", "x", "--host", "a//b"], "'a//b': expected a name of a-z, 0-9 and _"),
        (["cpm", "--to", "a:1", "--station-id", "1", "--host", "*"], "'*': expected a name of a-z, 0-9 and _"),
        (["acknowledge", "--fusion-host", ""], "expected the name of a host"),
        (["metrics", "--port", "99999"], "less than or equal to 65535"),
        (["hz", "x", "--seconds", "-1"], "greater than or equal to 0.05"),
        (["echo", "x", "-n", "-1"], "greater than or equal to 0"),
        (["record", "--keep-free", "nan"], "less than or equal to 1000000"),
        (["demo", "--namespace", "a/*"], "'a/*': expected one chunk of a key, of a-z, 0-9 and _"),
        (["ls", "--namespace", "A"], "'A': expected one chunk of a key, of a-z, 0-9 and _"),
        (["demo", "--port", "0"], "greater than or equal to 1"),
        (["demo", "--seconds", "-1"], "greater than or equal to 0"),
    ],
)
def test_options_out_of_range(words: list[str], said: str) -> None:
    refused = runner.invoke(app, words)
    assert (refused.exit_code, isinstance(refused.exception, SystemExit)) == (2, True)
    assert said in " ".join(refused.output.split())


@pytest.mark.parametrize("command", ["info", "echo", "hz"])
@pytest.mark.parametrize("key", ["", "a//b", "/a", "a?b", "*x", "a/**/**"])
def test_a_key_expression_that_is_none(command: str, key: str) -> None:
    refused = runner.invoke(app, [command, key])
    assert (refused.exit_code, refused.output.startswith(f"spotter: {key!r} is no key expression: ")) == (1, True)
    assert len(refused.output.splitlines()) == 1


@pytest.mark.parametrize(("inside", "why"), [("", "File exists"), ("/x", "Not a directory")])
def test_units_into_what_is_no_folder(tmp_path: Path, inside: str, why: str) -> None:
    (tmp_path / "file").touch()
    to = f"{tmp_path}/file{inside}"
    refused = runner.invoke(app, ["install", "pi0", "--to", to])
    said = f"spotter: --to {to}: expected a folder that takes the units: {to}: {why}"
    assert (refused.exit_code, refused.output.splitlines()[-1]) == (1, said)


def test_a_plot_names_the_endings_it_can_write(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "story.xyz"
    refused = runner.invoke(app, ["plot", str(recording), str(out)])
    assert (refused.exit_code, refused.output) == (
        1,
        f"spotter: {out}: expected a name that ends in .png, .svg, .pdf\n",
    )


@pytest.mark.parametrize("ending", ["svg", "pdf"])
def test_a_plot_as_a_drawing(recording: Path, tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"story.{ending}"
    assert runner.invoke(app, ["plot", str(recording), str(out)]).exit_code == 0
    assert out.stat().st_size > 1000


def test_a_plot_past_the_end(recording: Path, tmp_path: Path) -> None:
    refused = runner.invoke(app, ["plot", str(recording), str(tmp_path / "x.png"), "--from", "100"])
    assert refused.exit_code == 1
    assert refused.output == f"spotter: {recording} is 5.9 s long; --from 100 is past its end\n"


def test_a_plot_into_nowhere(recording: Path) -> None:
    refused = runner.invoke(app, ["plot", str(recording), "/proc/nowhere/x.png"])
    assert refused.output == "spotter: /proc/nowhere/x.png: cannot be written: No such file or directory\n"


def test_a_table_into_nowhere(recording: Path) -> None:
    refused = runner.invoke(app, ["export", str(recording), "/proc/nowhere/x.csv"])
    assert (refused.exit_code, refused.output) == (
        1,
        "spotter: /proc/nowhere/x.csv: cannot be written: No such file or directory\n",
    )


def test_a_recording_that_cannot_be_read_is_not_blamed_on_the_file_that_is_to_be_written(tmp_path: Path) -> None:
    for words in (["export", "/proc/self/mem", str(tmp_path / "x.csv")], ["replay", "--verify", "/proc/self/mem"]):
        refused = runner.invoke(app, words)
        assert (refused.exit_code, refused.output) == (
            1,
            "spotter: /proc/self/mem: cannot be read: Input/output error\n",
        )


@pytest.mark.parametrize("command", [["export"], ["info"], ["replay"], ["replay", "--verify"], ["plot"]])
def test_a_folder_in_the_place_of_a_recording(command: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "a.mcap"
    folder.mkdir()
    out = [str(tmp_path / "x.svg"), "--as", "csv"] if command == ["export"] else [str(tmp_path / "x.svg")]
    refused = runner.invoke(app, [*command, str(folder), *(out if command[0] in ("export", "plot") else [])])
    assert (refused.exit_code, refused.output) == (1, f"spotter: {folder}: cannot be read: Is a directory\n")


@pytest.mark.parametrize(
    ("seek", "code", "said"),
    [
        ("100", 1, "nothing to play: no message of ours at --seek 100 or later"),
        ("-1", 2, "--seek -1: expected seconds from the beginning, 0 or more"),
        ("nan", 2, "--seek nan: expected seconds from the beginning, 0 or more"),
        ("inf", 2, "--seek inf: expected seconds from the beginning, 0 or more"),
    ],
)
def test_a_replay_from_where_there_is_nothing(
    seek: str, code: int, said: str, recording: Path, router_endpoint: str
) -> None:
    refused = runner.invoke(app, ["replay", str(recording), "--loop", "--seek", seek, "--connect", router_endpoint])
    assert (refused.exit_code, refused.output) == (code, f"spotter: {said}\n")


def test_a_recording_into_nowhere(router_endpoint: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    refused = runner.invoke(app, ["record", str(tmp_path / "file" / "x"), "--connect", router_endpoint])
    assert refused.exit_code == 1
    assert refused.output.splitlines()[-1] == (
        f"spotter: {tmp_path}/file/x: Not a directory; nothing can be recorded there"
    )


def test_a_recording_of_nothing_is_no_success(router_endpoint: str, tmp_path: Path) -> None:
    refused = runner.invoke(app, ["record", str(tmp_path), "--seconds", "1", "--connect", router_endpoint])
    assert refused.exit_code == 1
    assert "not one message came; `spotter ls` shows who is alive" in refused.output


@pytest.mark.parametrize(
    ("constraints", "install"),
    [
        ("constraints.txt", 'uv pip install -c constraints.txt ".[record]"'),
        ("none.txt", "pip install 'spotter-0.1.0-py3-none-any.whl[record]'"),
    ],
    ids=["clone", "wheel"],
)
def test_an_extra_that_is_missing_is_named_with_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, constraints: str, install: str
) -> None:
    (tmp_path / "constraints.txt").touch()
    monkeypatch.setattr(fail, "CONSTRAINTS", tmp_path / constraints)
    monkeypatch.setitem(sys.modules, "common.recording.reader", None)
    refused = runner.invoke(app, ["export", str(tmp_path / "x.mcap"), str(tmp_path / "x.csv")])
    assert refused.exit_code == 1
    assert refused.output == f"spotter: exporting needs the extra `record`, which is not installed: {install}\n"
