"""The shipped file is the documentation of the defaults."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest

from common.config import ConfigError, load
from services.jetson.dashboard import config as dashboard_config
from services.jetson.dashboard.config import DashboardConfig

FILE = Path(dashboard_config.__file__).parent / "dashboard.toml"


def keys(table: dict[str, object], prefix: str = "") -> set[str]:
    found: set[str] = set()
    for key, value in table.items():
        found |= keys(value, f"{prefix}{key}.") if isinstance(value, dict) and value else {prefix + key}
    return found


def test_the_file_loads_and_equals_the_defaults() -> None:
    assert load(DashboardConfig, FILE) == DashboardConfig()


def test_the_file_lists_every_key() -> None:
    assert keys(tomllib.loads(FILE.read_text())) == keys(msgspec.to_builtins(DashboardConfig())) - {"map"}


def test_the_place_of_the_map_stands_in_the_file_as_a_comment(tmp_path: Path) -> None:
    text = FILE.read_text()
    beginning = text.index("# [map]")
    lines = text[beginning : text.index("[server]", beginning)].splitlines()
    (tmp_path / "map.toml").write_text("\n".join(line.removeprefix("# ") for line in lines))
    origin = load(DashboardConfig, tmp_path / "map.toml").map
    assert origin is not None
    assert set(keys(tomllib.loads((tmp_path / "map.toml").read_text())["map"])) == set(origin.__struct_fields__)


@pytest.mark.parametrize(
    ("setting", "error_text"),
    [
        ("server.port=70000", "port"),
        ("server.max_clients=0", "max_clients"),
        ("server.token=geheim\u00e4", "token"),  # a cookie holds ASCII only
        ("server.max_rate_hz=1000", "max_rate_hz"),
        ("server.adress=0.0.0.0", "did you mean 'address'"),
        ("server.address=0.0.0.0", "token"),
        ("host=Jetson 0", "host"),
    ],
)
def test_a_wrong_value_is_refused_by_name(setting: str, error_text: str) -> None:
    with pytest.raises(ConfigError, match=error_text):
        load(DashboardConfig, None, [setting])


@pytest.mark.parametrize("given", [(), ("server.address=0.0.0.0",)], ids=["in the file", "before its token"])
def test_a_token_may_come_after_the_address_that_needs_it(tmp_path: Path, given: tuple[str, ...]) -> None:
    """A file names the address and `--set` the secret; or both are set, in either order."""
    path = tmp_path / "dashboard.toml"
    path.write_text("" if given else '[server]\naddress = "0.0.0.0"\n')
    assert load(DashboardConfig, path, [*given, "server.token=sesame"]).server.token == "sesame"
    with pytest.raises(ConfigError, match="set \\[server\\] token"):
        load(DashboardConfig, path, given)
