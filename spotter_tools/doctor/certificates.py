"""Checks of the certificates, with the standard library only: a host has no library to make certificates."""

from __future__ import annotations

import ssl
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from common.config import ConfigError
from common.host.site import Site
from common.security.names import read_names
from spotter_tools.doctor.findings import Finding, broken, ok, warning

SOON_S = 30 * 86_400
NOT_YET_VALID = 9  # OpenSSL's X509_V_ERR_CERT_NOT_YET_VALID


def check_certificate(site: Site, name: str, keys: Path) -> Iterator[Finding]:
    """Key pair there, private, matching, signed by the site's authority, in date, not revoked."""
    if not site.tls.enabled:
        yield warning("tls", "OPEN MODE: whoever reaches a port may read and say anything", "set [tls] enabled = true")
        return
    issue = f"`spotter keys {'host' if name in site.hosts else 'laptop'} {name}`"
    files = [keys / "ca.crt", keys / f"{name}.crt", keys / f"{name}.key"]
    for path in files:
        if not path.exists():
            yield broken("certificate", f"{path} is not there", f"{issue}, then bundle and unpack it")
            return
    if stat.S_IMODE(files[2].stat().st_mode) & 0o077:
        yield broken("private key", f"{files[2]} can be read by others", f"chmod 600 {files[2]}")
    if damage := authority_damage(files[0]):
        yield broken(
            "authority",
            f"the authority's certificate {files[0]} cannot be read: {damage}",
            f"unpack it again from what `spotter keys bundle {name}` packs",
        )
        return
    try:
        certificate = peer_certificate(*files)
    except (ssl.SSLError, OSError) as error:
        if getattr(error, "verify_code", 0) == NOT_YET_VALID:
            yield broken(
                "clock", clock_is_behind(files[1]), "set the clock (chrony); the certificate itself is in order"
            )
            return
        yield broken("certificate", f"{files[1]}: {error}", f"issue it again: {issue}")
        return
    yield _lifetime(certificate, issue)
    yield _register(certificate, name, keys, issue)


def authority_damage(authority: Path) -> str:
    """Why the file is no certificate of an authority, which is no fault of a host's own; "" = it is one."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(authority)
    except OSError as error:  # ssl.SSLError is one
        return "no certificate, or a damaged one" if isinstance(error, ssl.SSLError) else str(error.strerror)
    return ""


def clock_is_behind(certificate: Path) -> str:
    """The words for a certificate that is not valid yet."""
    now = time.strftime("%Y-%m-%d %H:%M", time.gmtime())
    return f"this host's clock says {now} UTC, which is before {certificate} begins to be valid"


def peer_certificate(authority: Path, certificate: Path, key: Path) -> dict[str, Any]:
    """The certificate as a neighbour would see it: from a handshake with ourselves, in memory.

    Raises:
        ssl.SSLError: pair does not match, another authority, out of date.
    """
    ours = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    ours.load_cert_chain(certificate, key)
    ours.load_verify_locations(authority)
    ours.verify_mode = ssl.CERT_REQUIRED
    theirs = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    theirs.load_cert_chain(certificate, key)
    theirs.load_verify_locations(authority)
    theirs.check_hostname = False
    theirs.verify_mode = ssl.CERT_NONE
    up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
    server, client = ours.wrap_bio(up, down, server_side=True), theirs.wrap_bio(down, up)
    waiting = {client, server}
    while waiting:
        for side in (client, server):
            try:
                side.do_handshake()
                waiting.discard(side)
            except ssl.SSLWantReadError:
                continue
    found = server.getpeercert()
    assert found is not None
    return found


def _lifetime(certificate: dict[str, Any], issue: str) -> Finding:
    left_s = ssl.cert_time_to_seconds(certificate["notAfter"]) - time.time()
    validity = f"valid for {left_s / 86_400:.0f} more days"
    if left_s < SOON_S:
        return warning("certificate expiry", validity, f"{issue}, bundle and unpack it; the router follows")
    return ok("certificate expiry", validity)


def _register(certificate: dict[str, Any], name: str, keys: Path, issue: str) -> Finding:
    common_name = {key: value for ((key, value),) in certificate["subject"]}.get("commonName", "")
    try:
        entry = read_names(keys).names.get(name)
    except ConfigError as error:
        return broken("names", str(error), "copy names.json from the machine with the authority")
    if entry is None:
        return broken("names", f"{name} is not in names.json", "copy names.json from the machine with the authority")
    if common_name in entry.revoked:
        return broken("names", f"{common_name} is revoked", f"{issue} issues a new one")
    if common_name != entry.common_name(name):
        return broken(
            "names", f"CN={common_name}, but {entry.common_name(name)} is allowed", "copy the new certificate"
        )
    return ok("names", f"{common_name} is allowed")
