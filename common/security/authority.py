"""The site's certificate authority: elliptic-curve keys (P-256), X.509 certificates whose common name is the host.

The authority's key stays on the machine where ``spotter keys init`` ran; a host gets its own pair, ``ca.crt`` and
``names.json`` and nothing else.
"""

from __future__ import annotations

import datetime as dt
import ipaddress
import os
import re
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from msgspec.structs import replace

from common.config import ConfigError
from common.security.names import Kind, Name, read_names, write_names

AUTHORITY_DAYS = 3650
DAYS: dict[Kind, int] = {"host": 730, "laptop": 365}
BACKDATED = dt.timedelta(days=1)  # a Pi without a battery clock may start a little in the past
AUTHORITY = "ca"
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,59}")  # a common name has 64 characters at the most
LIKE_A_SECOND_ISSUE = re.compile(r".*\.\d+")  # as ``Name.common_name`` makes it


def init(folder: Path, site: str, days: int = AUTHORITY_DAYS) -> Path:
    """Make the authority; returns its certificate.

    Raises:
        ConfigError: there is one already: every certificate of the site would stop working.
    """
    if (folder / "ca.key").exists():
        raise ConfigError(f"{folder / 'ca.key'}: the authority exists; a new one would shut out every host")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"{site} site authority")
    certificate = (
        _builder(name, name, key.public_key(), days)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    _write_pair(folder, AUTHORITY, key, certificate)
    return folder / "ca.crt"


def issue(folder: Path, name: str, kind: Kind, addresses: tuple[str, ...] = (), days: int | None = None) -> Path:
    """A key pair for a host or a laptop, entered in the register; returns the certificate.

    Raises:
        ConfigError: no authority here, the name belongs to the other kind, or it would take the place of the
            authority's files or of another name's certificate.
    """
    if name == AUTHORITY or not NAME.fullmatch(name) or LIKE_A_SECOND_ISSUE.fullmatch(name):
        raise ConfigError(
            f"{name!r}: expected a name of at most 60 letters, digits, _, - and dots, not {AUTHORITY!r}, and without "
            "a dot and a number at its end"
        )
    names = read_names(folder)
    known = names.names.get(name)
    if known is not None and known.kind != kind:
        raise ConfigError(f"{name!r} is a {known.kind} already; a {kind} needs a name of its own")
    generation = 1 if known is None else known.generation + (0 if known.allowed(name) else 1)
    entry = Name(kind=kind, generation=generation, revoked=known.revoked if known else ())
    authority_key, authority = read_authority(folder)
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = (
        _builder(authority.subject, _name(entry.common_name(name)), key.public_key(), days or DAYS[kind])
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(_purposes(kind), critical=False)
        .add_extension(x509.SubjectAlternativeName(_alternatives((name, *addresses))), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False)
        .sign(authority_key, hashes.SHA256())
    )
    _write_pair(folder, name, key, certificate)
    expires = certificate.not_valid_after_utc.date().isoformat()
    entry = replace(entry, serial=f"{certificate.serial_number:x}", expires=expires)
    write_names(folder, names.with_name(name, entry))
    return folder / f"{name}.crt"


def revoke(folder: Path, name: str) -> str:
    """Take a name out of every allow list; returns the common name that is no longer allowed.

    Raises:
        ConfigError: never issued, or revoked already.
    """
    names = read_names(folder)
    entry = names.names.get(name)
    if entry is None:
        raise ConfigError(f"{name!r} was never issued; known: {', '.join(names.names) or 'none'}")
    if not entry.allowed(name):
        raise ConfigError(f"{name!r} is revoked already")
    gone = entry.common_name(name)
    write_names(folder, names.with_name(name, replace(entry, revoked=(*entry.revoked, gone))))
    return gone


def read_authority(folder: Path) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    """Raises ``ConfigError`` when the authority's key is not in this folder."""
    try:
        key = serialization.load_pem_private_key((folder / "ca.key").read_bytes(), None)
    except OSError as error:
        raise ConfigError(f"{folder / 'ca.key'}: {error.strerror}; run `spotter keys init` first") from None
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    return key, read_certificate(folder / "ca.crt")


def read_certificate(path: Path) -> x509.Certificate:
    """Raises ``ConfigError`` when it is missing or not PEM."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: not a PEM certificate: {error}") from None


def _builder(
    issuer: x509.Name, subject: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = dt.datetime.now(dt.UTC).replace(microsecond=0)
    return (
        x509.CertificateBuilder()
        .issuer_name(issuer)
        .subject_name(subject)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATED)
        .not_valid_after(now + dt.timedelta(days=days))
    )


def _purposes(kind: Kind) -> x509.ExtendedKeyUsage:
    """Only a host's router listens; a laptop's certificate cannot pose as one."""
    purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
    return x509.ExtendedKeyUsage([*purposes, ExtendedKeyUsageOID.SERVER_AUTH] if kind == "host" else purposes)


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _alternatives(names: tuple[str, ...]) -> list[x509.GeneralName]:
    found: list[x509.GeneralName] = []
    for name in dict.fromkeys(names):
        try:
            found.append(x509.IPAddress(ipaddress.ip_address(name)))
        except ValueError:
            found.append(x509.DNSName(name))
    return found


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _write_pair(folder: Path, name: str, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate) -> None:
    """Private key and certificate, both 0600 from the first byte on."""
    encoding, plain = serialization.Encoding.PEM, serialization.NoEncryption()
    _write_private(folder / f"{name}.key", key.private_bytes(encoding, serialization.PrivateFormat.PKCS8, plain))
    _write_private(folder / f"{name}.crt", certificate.public_bytes(encoding))


def _write_private(path: Path, content: bytes) -> None:
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)
