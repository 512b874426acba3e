"""systemd units: one per service, hardened, accepted by systemd; and what the watchdog tells it."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from common.bus.watchdog import Watchdog
from common.host.gpu_devices import JETSON, gpu_devices
from common.host.site import HostConfig, ServicePlace, Site
from common.host.systemd import hidden, needs_of, units
from spotter_tools.cli.__main__ import app


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


@pytest.mark.parametrize(
    ("source", "private_tmp"), [("csi:0", "no"), ("v4l2:0", "yes"), ("v4l2:/dev/v4l/by-id/usb-cam", "yes")]
)
def test_a_cameras_unit_can_start(
    source: str, private_tmp: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It sees the camera daemon's socket in /tmp and the GPU, by paths without patterns, which systemd refuses."""
    for name in ("nvmap", "nvhost-ctrl", "nvhost-gpu", "nvgpu/igpu0/ctrl", "dri/renderD128", "sda"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = gpu_devices(tmp_path)
    assert {Path(one).name for one in found} == {"nvmap", "nvhost-ctrl", "nvhost-gpu", "ctrl", "renderD128"}
    monkeypatch.setattr("common.host.systemd.gpu_devices", lambda: found)
    site = Site(hosts={"jetson0": HostConfig(services={"camera": ServicePlace(source=source)})})
    text = units(site, "jetson0", "spotter", "site.toml")["spotter-camera.service"]
    assert f"PrivateTmp={private_tmp}\n" in text
    assert "ProcSubset" not in text
    assert "SupplementaryGroups=video render\n" in text
    allowed = [line.removeprefix("DeviceAllow=") for line in text.splitlines() if line.startswith("DeviceAllow")]
    assert set(found) < set(allowed)
    assert not [one for one in allowed if one.startswith("/dev") and any(sign in one for sign in "*?[ ")]


def test_a_unit_that_is_written_elsewhere_names_a_jetsons_gpu(tmp_path: Path) -> None:
    assert gpu_devices(tmp_path) == JETSON


def test_all_other_units_keep_their_own_tmp_and_proc() -> None:
    site = Site(hosts={"a": HostConfig(services={"radar": ServicePlace(source="spi:0.0"), "fusion": ServicePlace()})})
    for name, text in units(site, "a", "spotter", "site.toml").items():
        assert name == "spotter.target" or "PrivateTmp=yes\nProcSubset=pid\n" in text


@pytest.mark.parametrize(("flags", "named"), [("fma avx2 bmi2", True), ("sse4_2 popcnt", False)])
def test_kernels_are_compiled_for_every_processor_with_avx2(
    flags: str, named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cpuinfo = tmp_path / "cpuinfo"
    cpuinfo.write_text(f"flags\t: fpu {flags} rdseed\n")
    monkeypatch.setattr("common.host.systemd.CPUINFO", cpuinfo)
    text = units(Site(), "infra0", "spotter", "site.toml")["spotter-infra-lidar.service"]
    assert ("NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=\n" in text) == named


def test_systemd_accepts_the_units_and_calls_them_safe(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    sources = {"radar": "spi:0.0", "lidar": "serial:/dev/ttyTHS1", "camera": "csi:0", "fusion": ""}
    host = HostConfig(services={name: ServicePlace(source=source) for name, source in sources.items()})
    for name, text in units(Site(hosts={"a": host}), "a", "/bin/true", "/etc/spotter/site.toml").items():
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
    result = CliRunner().invoke(app, ["install", "pi0", "--site", str(site), "--dry-run"])
    assert result.exit_code == 0
    assert f"no unit can see {site}" in result.stderr.replace(f"{sys.prefix}/bin/spotter, ", "")


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
    notifications = [systemd.recv(200).decode() for _ in range(3)]
    assert notifications == ["READY=1\nSTATUS=online", "STATUS=degraded why", "WATCHDOG=1"]


def test_without_systemd_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    watchdog = Watchdog("radar")
    watchdog.ready()
    watchdog.alive()
    assert watchdog.limit_s == 0.0


def test_a_container_is_told_by_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPOTTER_ALIVE", str(tmp_path / "alive"))
    watchdog = Watchdog("radar")
    watchdog.alive()
    assert (tmp_path / "alive" / "radar").exists()
    shutil.rmtree(tmp_path / "alive")  # somebody tidies up
    watchdog.alive()
    assert (tmp_path / "alive" / "radar").exists()
    shutil.rmtree(tmp_path / "alive")
    (tmp_path / "alive").touch()  # a folder cannot be made there
    watchdog.alive()


def test_the_udev_rules_are_matches_and_assignments() -> None:
    """udev passes over a line that it cannot read, so that nobody would notice."""
    text = (Path(__file__).parents[2] / "compose" / "60-spotter.rules").read_text()
    part = re.compile(r'(?:ACTION|SUBSYSTEM|KERNELS?|ATTRS\{\w+\}|ENV\{\w+\}|GROUP|MODE|SYMLINK)(?:==|=|\+=)"[^"]*"')
    rules = [line for line in text.splitlines() if line and not line.startswith("# ")]
    rules = [line.removeprefix("#") for line in rules]  # the one that is left to the reader too
    assert len(rules) == 7
    for line in rules:
        assert all(part.fullmatch(one.strip()) for one in line.split(",")), line
        assert "==" in line


def test_a_unit_names_the_vehicle_of_its_host() -> None:
    fusion = HostConfig(vehicle="car1", services={"fusion": ServicePlace()})
    site = Site(hosts={"jetson1": fusion})
    for text in units(site, "jetson1", "/usr/bin/spotter", "/etc/spotter/site.toml").values():
        assert "on jetson1 of car1\n" in text
