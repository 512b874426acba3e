"""Certificates: what they say, who may read the keys, and what a revocation does."""

from __future__ import annotations

import datetime as dt
import stat
import tarfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from typer.testing import CliRunner

from common.config import ConfigError
from common.security import authority
from common.security.names import read_names
from spotter_tools.cli.__main__ import app


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    authority.init(tmp_path / "keys", "spotter")
    return tmp_path / "keys"


def test_a_host_certificate_names_the_host_and_its_address(folder: Path) -> None:
    certificate = authority.read_certificate(authority.issue(folder, "pi0", "host", ("10.0.0.2", "pi.yard.example")))
    assert certificate.subject.rfc4514_string() == "CN=pi0"
    alternatives = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert set(alternatives.get_values_for_type(x509.DNSName)) == {"pi0", "pi.yard.example"}
    assert [str(a) for a in alternatives.get_values_for_type(x509.IPAddress)] == ["10.0.0.2"]
    public_key = certificate.public_key()
    assert isinstance(public_key, ec.EllipticCurvePublicKey)
    assert public_key.curve.name == "secp256r1"
    certificate.verify_directly_issued_by(authority.read_certificate(folder / "ca.crt"))


def test_lifetimes_begin_a_day_ago_and_end_in_two_years(folder: Path) -> None:
    certificate = authority.read_certificate(authority.issue(folder, "pi0", "host"))
    now = dt.datetime.now(dt.UTC)
    assert dt.timedelta(hours=23) < now - certificate.not_valid_before_utc < dt.timedelta(hours=25)
    assert dt.timedelta(days=729) < certificate.not_valid_after_utc - now <= dt.timedelta(days=730)


def test_a_laptop_cannot_pose_as_a_router(folder: Path) -> None:
    certificate = authority.read_certificate(authority.issue(folder, "laptop1", "laptop"))
    purposes = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert [purpose.dotted_string for purpose in purposes] == ["1.3.6.1.5.5.7.3.2"]  # client authentication


def test_only_the_owner_reads_the_keys(folder: Path) -> None:
    authority.issue(folder, "pi0", "host")
    for path in (*folder.glob("*.key"), *folder.glob("*.crt")):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600, path


def test_a_second_authority_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match="would shut out every host"):
        authority.init(folder, "spotter")


def test_a_revoked_name_that_is_issued_again_gets_a_new_common_name(folder: Path) -> None:
    authority.issue(folder, "pi0", "host")
    assert authority.revoke(folder, "pi0") == "pi0"
    assert read_names(folder).allowed("host") == {}
    authority.issue(folder, "pi0", "host")
    assert read_names(folder).allowed("host") == {"pi0": "pi0.2"}
    subject = authority.read_certificate(folder / "pi0.crt").subject.rfc4514_string()
    assert subject == "CN=pi0.2"
    assert authority.revoke(folder, "pi0") == "pi0.2"
    assert read_names(folder).names["pi0"].revoked == ("pi0", "pi0.2")


@pytest.mark.parametrize("name", ["ca", "pi0.2", "../laptop1", "a/b", "..", ".hidden", "", "two words", "x" * 61])
def test_a_name_that_would_take_the_place_of_something_else_is_refused(folder: Path, name: str) -> None:
    """``ca`` has the authority's files, ``pi0.2`` is what pi0 is called once it was revoked and issued again."""
    before = {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match="expected a name of"):
        authority.issue(folder, name, "laptop")
    assert {path: path.read_bytes() for path in folder.parent.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("name", ["laptop1", "anna-s.laptop", "Anna_2", "x" * 60])
def test_other_names_are_taken(folder: Path, name: str) -> None:
    assert authority.issue(folder, name, "laptop").name == f"{name}.crt"


def test_a_renewal_keeps_the_common_name(folder: Path) -> None:
    authority.issue(folder, "pi0", "host")
    authority.issue(folder, "pi0", "host")
    assert read_names(folder).allowed("host") == {"pi0": "pi0"}


def test_what_cannot_be_done_is_said(folder: Path, tmp_path: Path) -> None:
    authority.issue(folder, "pi0", "host")
    with pytest.raises(ConfigError, match="is a host already"):
        authority.issue(folder, "pi0", "laptop")
    with pytest.raises(ConfigError, match="never issued; known: pi0"):
        authority.revoke(folder, "pi1")
    authority.revoke(folder, "pi0")
    with pytest.raises(ConfigError, match="revoked already"):
        authority.revoke(folder, "pi0")
    with pytest.raises(ConfigError, match="run `spotter keys init` first"):
        authority.issue(tmp_path, "pi0", "host")


def test_the_commands_from_authority_to_revocation(tmp_path: Path) -> None:
    site = tmp_path / "site.toml"
    site.write_text("[hosts.pi0]\naddress = '10.0.0.2'\n[hosts.jetson0]\naddress = '10.0.0.3'\n")

    def spotter(*words: str) -> str:
        result = CliRunner().invoke(app, ["keys", *words, "--site", str(site)])
        assert result.exit_code == 0, result.output
        return result.output

    spotter("init")
    assert "CN=pi0" in spotter("host", "pi0")
    spotter("laptop", "lap")
    spotter("bundle", "pi0", "--out", str(tmp_path / "pi0.tar"))
    with tarfile.open(tmp_path / "pi0.tar") as archive:
        assert set(archive.getnames()) == {
            "keys/ca.crt", "keys/names.json", "keys/pi0.crt", "keys/pi0.key", "site.toml",
        }  # fmt: skip
    assert "names.json to pi0, jetson0: each router starts again" in spotter("revoke", "lap")
    assert "revoked" in spotter("list")


@pytest.mark.parametrize("words", [("host", "pi1"), ("laptop", "pi0"), ("revoke", "nobody"), ("host", "pi0")])
def test_a_command_that_cannot_work_ends_with_one_line(tmp_path: Path, words: tuple[str, ...]) -> None:
    site = tmp_path / "site.toml"
    site.write_text("[hosts.pi0]\naddress = '10.0.0.2'\n")
    result = CliRunner().invoke(app, ["keys", *words, "--site", str(site)])
    assert result.exit_code == 1
    assert result.output.startswith("spotter: ")
    assert len(result.output.splitlines()) == 1


def test_a_bundle_that_cannot_be_written_is_one_line_and_touches_nothing(
    tmp_path: Path, file_size_limit: Callable[[int], AbstractContextManager[None]]
) -> None:
    site, folder, tar = tmp_path / "site.toml", tmp_path / "folder", tmp_path / "pi0.tar"
    site.write_text("[hosts.pi0]\naddress = '10.0.0.2'\n")
    folder.mkdir(0o755)
    tar.write_bytes(b"the one from before")
    for words in (["init"], ["host", "pi0"]):
        assert CliRunner().invoke(app, ["keys", *words, "--site", str(site)]).exit_code == 0
    for out, room, said in (
        (Path("/no/folder"), 10**9, "No such file or directory; nothing was packed"),
        (folder, 10**9, "a folder, expected the name of a file"),
        (tar, 100, "File too large; nothing was packed"),
    ):
        with file_size_limit(room):
            result = CliRunner().invoke(app, ["keys", "bundle", "pi0", "--site", str(site), "--out", str(out)])
        assert (result.exit_code, result.output) == (1, f"spotter: --out {out}: {said}\n")
    assert (folder.stat().st_mode & 0o777, tar.read_bytes()) == (0o755, b"the one from before")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "keys", "pi0.tar", "site.toml"]
