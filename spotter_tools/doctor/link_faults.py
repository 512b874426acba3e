"""Why another host of the site cannot be linked: a TLS handshake with its router, and the router's alert.

A router that refuses our certificate ends the handshake with an alert (RFC 8446, section 6.2). ``certificate_expired``
stands for every certificate that is not valid now, so that with our own in date it means that the other clock is wrong.
"""

from __future__ import annotations

import socket
import ssl
import time
from dataclasses import dataclass
from pathlib import Path

from common.messages import LinkFault
from spotter_tools.doctor.certificates import NOT_YET_VALID, authority_damage, clock_is_behind, peer_certificate

HANDSHAKE_S = 2.0
ALERT_S = 0.5  # with TLS 1.3 our certificate is judged after our end of the handshake is done
EXPIRED, WRONG_NAME = 10, (62, 64)  # OpenSSL's X509_V_ERR_CERT_HAS_EXPIRED, _HOSTNAME_MISMATCH, _IP_ADDRESS_MISMATCH


@dataclass(frozen=True)
class OwnFiles:
    """The certificate of this host or laptop."""

    authority: Path
    certificate: Path
    key: Path
    kind: str = "host"

    @property
    def name(self) -> str:
        return self.certificate.stem


def own_fault(files: OwnFiles) -> LinkFault | None:
    """What keeps this host from every link: its own clock or certificate, or its copy of the authority's."""
    if damage := authority_damage(files.authority):
        why = f"the authority's certificate {files.authority} cannot be read: {damage}: copy ca.crt here again"
        return LinkFault(cause="certificate", why=why)
    try:
        peer_certificate(files.authority, files.certificate, files.key)
    except (ssl.SSLError, OSError) as error:
        code = getattr(error, "verify_code", 0)
        if code == NOT_YET_VALID:
            return LinkFault(cause="clock", why=clock_is_behind(files.certificate))
        what = "has expired" if code == EXPIRED else f"cannot be used: {error}"
        return LinkFault(
            cause="certificate", why=f"the certificate of {files.name} {what}: {issue_again(files.name, files.kind)}"
        )
    return None


def issue_again(name: str, kind: str = "host") -> str:
    """What to do about a certificate."""
    return f"issue it again with `spotter keys {kind} {name}`"


def link_fault(files: OwnFiles, host: str, address: str, port: int) -> LinkFault | None:
    """Why the router of ``host`` and ours cannot be linked. None: TLS is not the reason, or no router answers there."""
    own = own_fault(files)
    if own is not None:
        return own
    ours = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    ours.load_cert_chain(files.certificate, files.key)
    ours.load_verify_locations(files.authority)
    try:
        with (
            socket.create_connection((address, port), timeout=HANDSHAKE_S) as plain,
            ours.wrap_socket(plain, server_hostname=address) as link,
        ):
            link.settimeout(ALERT_S)
            link.recv(1)
    except ssl.SSLCertVerificationError as error:
        return _their_certificate(host, address, error)
    except ssl.SSLError as error:
        return _refused(files.name, host, error.reason or "")
    except OSError:
        return None  # no answer, or it waits for our first data: then it has accepted our certificate
    return None


def _their_certificate(host: str, address: str, error: ssl.SSLCertVerificationError) -> LinkFault:
    if error.verify_code == NOT_YET_VALID:
        now = time.strftime("%Y-%m-%d %H:%M", time.gmtime())
        why = f"the certificate of {host} begins after {now} UTC, the time of this host's clock: which clock is wrong?"
        return LinkFault(cause="clock", why=why)
    if error.verify_code == EXPIRED:
        return LinkFault(cause="certificate", why=f"the certificate of {host} has expired: {issue_again(host)}")
    if error.verify_code in WRONG_NAME:
        why = f"the certificate of {host} is not for {address}: {issue_again(host)}, which takes the new address"
        return LinkFault(cause="certificate", why=why)
    return LinkFault(cause="certificate", why=f"the certificate of {host} is refused: {error.verify_message}")


def _refused(own: str, host: str, alert: str) -> LinkFault | None:
    if "ALERT" not in alert:
        return None  # the other end does not use TLS
    said = alert.rpartition("ALERT_")[2].replace("_", " ").lower()
    if said == "certificate expired":
        why = f"clock of {host} is wrong: to it the certificate of {own}, which is in date, is out of date"
        return LinkFault(cause="clock", why=why)
    return LinkFault(cause="certificate", why=f"{host} refuses the certificate of {own}: {said}")
