"""systemd units: one per service, hardened, accepted by systemd; and what the watchdog tells it."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from common.cli.__main__ import app
from common.site import HostConfig, ServicePlace, Site
from common.systemd import hidden, needs_of, units
from common.watchdog import Watchdog


def test_each_service_has_a_unit_and_the_router_too() -> None:
    files = units(Site(), "jetson0", "/opt/spotter/bin/spotter", "/etc/spotter/site.toml")
    assert set(files) == {
        "spotter.target", "spotter-router.service", "spotter-lidar.service", "spotter-camera.service",
        "spotter-fusion.service", "spotter-dashboard.service",
    }  # fmt: skip
    start = "ExecStart=/opt/spotter/bin/spotter up jetson0 --site /etc/spotter/site.toml --only fusion\n"
    assert start in files["spotter-fusion.service"]


@pytest.mark.parametrize(
    ("service", "source", "lines"),
    [
        ("radar", "spi:0.0", ["SupplementaryGroups=spi gpio", "DeviceAllow=char-spidev", "IPAddressDeny=any"]),
        ("lidar", "serial:/dev/ttyTHS1", ["SupplementaryGroups=dialout", "IPAddressDeny=any"]),
        ("radar", "sim:crossing", ["PrivateDevices=yes", "IPAddressDeny=any"]),
        ("infra_lidar", "ouster://10.0.0.9", ["PrivateDevices=yes", "MemoryMax=2G"]),
        ("blackbox", "", ["WorkingDirectory=%S/spotter", "StateDirectory=spotter", "PrivateDevices=yes"]),
    ],
)
def test_a_unit_may_use_what_its_source_needs_and_no_more(service: str, source: str, lines: list[str]) -> None:
    site = Site(hosts={"pi0": HostConfig(services={service: ServicePlace(source=source)})})
    text = units(site, "pi0", "spotter", "site.toml")[f"spotter-{service.replace('_', '-')}.service"]
    for line in lines:
        assert f"{line}\n" in text
    assert needs_of(service, source).network == (source.startswith("ouster"))
    assert ("IPAddressDeny" in text) == (not source.startswith("ouster"))


def test_systemd_accepts_the_units_and_calls_them_safe(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    for name, text in units(Site(), "pi0", "/bin/true", "/etc/spotter/site.toml").items():
        (tmp_path / name).write_text(text)
    names = [str(path) for path in tmp_path.glob("*.service")]
    verified = subprocess.run(["systemd-analyze", "verify", *names], capture_output=True, text=True, check=False)
    assert not [line for line in verified.stderr.splitlines() if "spotter" in line], verified.stderr
    for name in names:
        rated = subprocess.run(
            ["systemd-analyze", "security", "--offline=true", "--threshold=25", name],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert rated.returncode == 0, rated.stdout[-300:]  # exposure below 2.5 of 10


def test_what_a_unit_cannot_see_is_told_before_it_fails_to_start(tmp_path: Path) -> None:
    seen, unseen = ["/opt/spotter/bin/spotter", "/etc/spotter/site.toml"], ["/home/pi/site.toml", "/root/.local/python"]
    assert hidden(*seen, *unseen) == unseen
    site = tmp_path / "site.toml"  # below /tmp
    site.write_text("[hosts.pi0.services.radar]\n")
    told = CliRunner().invoke(app, ["install", "pi0", "--site", str(site), "--dry-run"])
    assert told.exit_code == 0
    assert f"no unit can see {site}" in told.stderr.replace(f"{sys.prefix}/bin/spotter, ", "")


def test_install_writes_what_the_dry_run_shows(tmp_path: Path) -> None:
    shown = CliRunner().invoke(app, ["install", "pi0", "--dry-run", "--to", str(tmp_path)])
    assert shown.exit_code == 0
    assert not list(tmp_path.iterdir())
    written = CliRunner().invoke(app, ["install", "pi0", "--to", str(tmp_path)])
    assert written.exit_code == 0, written.output
    for path in tmp_path.iterdir():
        assert path.read_text() in shown.output
    assert CliRunner().invoke(app, ["install", "pi9", "--dry-run"]).exit_code == 2


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The socket on which systemd would listen."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(5.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "30000000")
        yield listener


def test_ready_is_said_once_and_alive_often(systemd: socket.socket) -> None:
    watchdog = Watchdog("radar")
    assert watchdog.limit_s == 30.0
    watchdog.ready("online")
    watchdog.ready("degraded why")
    watchdog.alive()
    told = [systemd.recv(200).decode() for _ in range(3)]
    assert told == ["READY=1\nSTATUS=online", "STATUS=degraded why", "WATCHDOG=1"]


def test_without_systemd_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    watchdog = Watchdog("radar")
    watchdog.ready()
    watchdog.alive()
    assert watchdog.limit_s == 0.0


def test_a_container_is_told_by_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPOTTER_ALIVE", str(tmp_path / "alive"))
    Watchdog("radar").alive()
    assert (tmp_path / "alive" / "radar").exists()
