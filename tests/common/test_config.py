"""A wrong configuration is refused with file, key, value and what is allowed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec
import pytest

from common.config import ConfigError, Section, ServiceConfig, config_hash, load
from common.source_url import SourceUrl, parse_source


class Cfar(Section, frozen=True, kw_only=True):
    threshold_db: Annotated[float, msgspec.Meta(ge=0, le=60)] = 16.0
    kind: Literal["ca", "os"] = "ca"


class Example(ServiceConfig, frozen=True, kw_only=True):
    cfar: Cfar = Cfar()
    gains_db: tuple[float, ...] = (1.0, 2.0)

    def __post_init__(self) -> None:
        if len(self.gains_db) > 3:
            raise ValueError(f"gains_db = {list(self.gains_db)}: at most three")


def write(folder: Path, text: str) -> Path:
    path = folder / "example.toml"
    path.write_text(text)
    return path


def test_file_over_defaults_and_overrides_over_file(tmp_path: Path) -> None:
    path = write(tmp_path, 'host = "pi7"\n[cfar]\nthreshold_db = 12\n')
    config = load(Example, path, ["cfar.kind=os", "gains_db=[3.0]", "source=file:/a b.bin?loop=1"])
    assert (config.host, config.cfar.threshold_db, config.cfar.kind) == ("pi7", 12.0, "os")
    assert (config.gains_db, config.source) == ((3.0,), "file:/a b.bin?loop=1")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[cfar]\nthreshhold_db = 16", "[cfar] threshhold_db = 16: no such key; did you mean 'threshold_db'?"),
        ("[cfar]\nthreshold_db = 90", "[cfar] threshold_db = 90: expected `float` <= 60"),
        ("[cfar]\nthreshold_db = 'x'", "[cfar] threshold_db = 'x': expected `float`, got `str`"),
        ("[cfar]\nkind = 'xx'", "[cfar] kind = 'xx': invalid enum value 'xx'; allowed: 'ca', 'os'"),
        ("gains_db = [1, 'b']", "gains_db"),
        ("gains_db = [1, 2, 3, 4]", "at most three"),
        ("host = 'Pi 0'", "host = 'Pi 0'"),
        ("cfar = 3", "cfar = 3: expected `object`"),
        ("cfar = [", "not TOML"),
    ],
)
def test_refusals_name_file_key_value_and_allowed(tmp_path: Path, text: str, expected: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as refusal:
        load(Example, path)
    assert str(path) in str(refusal.value)
    assert expected in str(refusal.value)


class Choices(ServiceConfig, frozen=True, kw_only=True):
    levels: tuple[Literal["low", "high"], ...] = ()
    pair: tuple[int, Literal[4, 8]] = (1, 4)
    hosts: dict[str, Cfar] = msgspec.field(default_factory=dict)
    unset: Literal["yes", "no"] | None = None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("levels = ['low', 'mid']", "allowed: 'high', 'low'"),
        ("pair = [3, 5]", "allowed: 4, 8"),
        ("[hosts.pi0]\nkind = 'xx'", "allowed: 'ca', 'os'"),
        ("unset = 'maybe'", "allowed: 'no', 'yes'"),
    ],
)
def test_choices_are_named_wherever_they_stand(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        load(Choices, write(tmp_path, text))
    assert str(refusal.value).endswith(expected)


def test_a_wrong_override_is_blamed_on_the_command_line() -> None:
    with pytest.raises(ConfigError, match=r"--set: \[cfar\] thresh = 1"):
        load(Example, None, ["cfar.thresh=1"])
    with pytest.raises(ConfigError, match=r"--set.*threshold_db = 99"):
        load(Example, None, ["cfar.threshold_db=99"])
    with pytest.raises(ConfigError, match=r"expected section\.key=value"):
        load(Example, None, ["cfar"])
    with pytest.raises(ConfigError, match=r"host"):
        load(Example, None, ["host.name=3"])


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        load(Example, tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="is a folder"):
        load(Example, tmp_path)


def test_hash_tells_configurations_apart() -> None:
    assert config_hash(Example()) == config_hash(Example())
    assert config_hash(Example()) != config_hash(Example(gains_db=(9.0,)))


SCHEMES = {"sim": ("t0",), "file": ("rate", "loop"), "serial": ()}


def test_source_urls() -> None:
    source = parse_source("file:/data/a.bin?rate=2.5&loop=1", SCHEMES)
    assert (source.scheme, source.target, source.number("rate", 1.0), source.flag("loop")) == (
        "file", "/data/a.bin", 2.5, True,
    )  # fmt: skip
    assert parse_source("serial:/dev/ttyTHS1", SCHEMES).target == "/dev/ttyTHS1"
    assert parse_source("sim:crossing", SCHEMES).number("t0", 3.0) == 3.0


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("ouster://os-1.local?port=7502", "os-1.local"),
        ("ouster:os-1.local", "os-1.local"),
        ("ouster:///dev/x", "/dev/x"),
        ("file://server/a.bin?rate=2", "//server/a.bin"),
        ("file:/data/a.bin", "/data/a.bin"),
    ],
)
def test_a_source_is_shown_as_it_was_written(text: str, target: str) -> None:
    source = parse_source(text, {"ouster": ("port",), "file": ("rate",)})
    assert (str(source), source.target) == (text, target)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "no source: give one with --source"),
        ("/dev/tty", "expected one of"),
        ("ftp:x", "expected one of"),
        ("sim:crossing?t1=3", "no parameter 't1' for sim:; allowed: t0"),
        ("serial:/dev/x?a=1", "allowed: none"),
    ],
)
def test_source_refusals(text: str, expected: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        parse_source(text, SCHEMES)
    assert expected in str(refusal.value)


def test_source_number_must_be_one() -> None:
    with pytest.raises(ConfigError, match="rate='fast' is not a number"):
        parse_source("file:a?rate=fast", SCHEMES).number("rate", 1.0)


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999"])
def test_source_number_must_be_finite(text: str) -> None:
    with pytest.raises(ConfigError, match=f"rate='{text}' is not a finite number"):
        parse_source(f"file:a?rate={text}", SCHEMES).number("rate", 1.0)


@pytest.mark.parametrize("text", ["", "0", "-1", "65536", "70000", "2368.0", "x", "²", "9" * 5000])
def test_source_port_must_be_one(text: str) -> None:
    source = SourceUrl("velodyne", "", {"port": text, "highest": "65535"})
    with pytest.raises(ConfigError, match="port: expected a port from 1 to 65535, found '"):
        source.port("port", 2368)
    assert (source.port("other", 2368), source.port("highest", 2368)) == (2368, 65535)
