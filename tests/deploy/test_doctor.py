"""What doctor finds, and that each finding says what to do."""

from __future__ import annotations

import datetime as dt
import json
import shutil
import socket
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from cryptography import x509
from typer.testing import CliRunner

from common.host.site import HostConfig, Site, TlsConfig
from common.security import authority
from spotter_tools.cli.__main__ import app
from spotter_tools.doctor.certificates import check_certificate
from spotter_tools.doctor.findings import Finding
from spotter_tools.doctor.link_faults import OwnFiles, own_fault
from spotter_tools.doctor.machine import check_machine, check_ports, check_provider


def grades(found: Iterable[Finding]) -> dict[str, str]:
    listed = list(found)
    assert all(finding.do for finding in listed if finding.grade != "ok")
    return {finding.check: finding.grade for finding in listed}


@pytest.fixture
def own_keys(keys: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(keys, tmp_path / "keys"))


def test_good_certificates_are_good(own_keys: Path) -> None:
    found = grades(check_certificate(Site(), "pi0", own_keys))
    assert found == {"certificate expiry": "ok", "names": "ok"}


def test_the_open_mode_is_a_warning(tmp_path: Path) -> None:
    assert grades(check_certificate(Site(tls=TlsConfig(enabled=False)), "pi0", tmp_path)) == {"tls": "warning"}


def test_a_missing_certificate_is_broken(tmp_path: Path) -> None:
    assert grades(check_certificate(Site(), "pi0", tmp_path)) == {"certificate": "broken"}


def test_a_clock_before_the_certificate_is_the_clock_s_fault(own_keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a host that begins in 1970: to it every certificate is from the future."""
    monkeypatch.setattr(authority, "BACKDATED", -dt.timedelta(days=1))
    authority.issue(own_keys, "pi0", "host", ("127.0.0.1",))
    (found,) = check_certificate(Site(), "pi0", own_keys)
    assert (found.check, found.grade) == ("clock", "broken")
    assert "before" in found.what
    assert found.do == "set the clock (chrony); the certificate itself is in order"


def test_a_key_that_others_can_read_is_broken(own_keys: Path) -> None:
    (own_keys / "pi0.key").chmod(0o644)
    assert grades(check_certificate(Site(), "pi0", own_keys))["private key"] == "broken"


def test_a_key_of_another_certificate_is_broken(own_keys: Path) -> None:
    shutil.copy(own_keys / "jetson0.key", own_keys / "pi0.key")
    assert grades(check_certificate(Site(), "pi0", own_keys)) == {"certificate": "broken"}


def test_a_certificate_of_another_authority_is_broken(own_keys: Path, tmp_path: Path) -> None:
    authority.init(tmp_path / "other", "elsewhere")
    shutil.copy(tmp_path / "other" / "ca.crt", own_keys / "ca.crt")
    assert grades(check_certificate(Site(), "pi0", own_keys)) == {"certificate": "broken"}


@pytest.mark.parametrize("left", [0, 200])
def test_a_damaged_certificate_of_the_authority_is_not_blamed_on_the_host_s(own_keys: Path, left: int) -> None:
    authority_file = own_keys / "ca.crt"
    authority_file.write_bytes(authority_file.read_bytes()[:left])
    (found,) = check_certificate(Site(), "pi0", own_keys)
    said = f"the authority's certificate {authority_file} cannot be read: no certificate, or a damaged one"
    assert (found.grade, found.check, found.what) == ("broken", "authority", said)
    assert found.do == "unpack it again from what `spotter keys bundle pi0` packs"
    fault = own_fault(OwnFiles(authority_file, own_keys / "pi0.crt", own_keys / "pi0.key"))
    assert fault is not None
    assert (fault.cause, fault.why) == ("certificate", f"{said}: copy ca.crt here again")


def test_a_certificate_that_ends_soon_is_a_warning(own_keys: Path) -> None:
    authority.issue(own_keys, "pi0", "host", days=5)
    assert grades(check_certificate(Site(), "pi0", own_keys))["certificate expiry"] == "warning"


def test_an_expired_certificate_is_broken(own_keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original, past = x509.CertificateBuilder.not_valid_after, dt.datetime.now(dt.UTC) - dt.timedelta(hours=1)
    monkeypatch.setattr(x509.CertificateBuilder, "not_valid_after", lambda self, _: original(self, past))
    authority.issue(own_keys, "pi0", "host")
    assert grades(check_certificate(Site(), "pi0", own_keys)) == {"certificate": "broken"}


def test_a_revoked_name_is_broken_until_it_is_issued_again(own_keys: Path) -> None:
    authority.revoke(own_keys, "pi0")
    assert grades(check_certificate(Site(), "pi0", own_keys))["names"] == "broken"
    authority.issue(own_keys, "pi0", "host")
    assert grades(check_certificate(Site(), "pi0", own_keys))["names"] == "ok"


def test_an_old_register_is_broken(own_keys: Path) -> None:
    (own_keys / "names.json").write_text("{}")
    assert grades(check_certificate(Site(), "pi0", own_keys))["names"] == "broken"
    (own_keys / "names.json").write_text("not ours")
    assert grades(check_certificate(Site(), "pi0", own_keys))["names"] == "broken"


def test_ports(free_ports: Callable[[], int]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        host = HostConfig(local_port=listener.getsockname()[1], port=free_ports())
        found = grades(check_ports(Site(hosts={"pi0": host}), "pi0"))
    assert found == {"pi0 local_port": "ok", "pi0 port": "broken"}


def test_the_machine_is_looked_at(tmp_path: Path) -> None:
    found = grades(check_machine(tmp_path, low_bytes=0, none_bytes=0))
    assert set(found) == {"disk", "clock", "versions"}
    assert found["disk"] == "ok"


def test_a_disk_that_fills_up(tmp_path: Path) -> None:
    free_bytes = shutil.disk_usage(tmp_path).free
    assert grades(check_machine(tmp_path, low_bytes=2 * free_bytes, none_bytes=0))["disk"] == "warning"
    assert grades(check_machine(tmp_path, low_bytes=2 * free_bytes, none_bytes=2 * free_bytes))["disk"] == "broken"


def test_the_provider_of_the_networks_is_named_and_a_jetson_without_its_own_is_warned() -> None:
    pytest.importorskip("onnxruntime")
    assert grades(check_provider("x86_64")) == {"onnxruntime": "ok"}
    assert grades(check_provider("aarch64")) == {"onnxruntime": "warning"}


def test_the_command_ends_with_1_when_something_is_broken(tmp_path: Path, free_ports: Callable[[], int]) -> None:
    site = tmp_path / "site.toml"
    site.write_text(f"[hosts.pi0]\nlocal_port = {free_ports()}\nport = {free_ports()}\n")
    result = CliRunner().invoke(app, ["doctor", "pi0", "--site", str(site), "--json"])
    found = [json.loads(line) for line in result.output.splitlines()]
    assert result.exit_code == 1
    assert {"own router", "certificate", "pi0 port"} <= {row["check"] for row in found if row["grade"] == "broken"}
    assert CliRunner().invoke(app, ["doctor", "pi9", "--site", str(site)]).exit_code == 2
