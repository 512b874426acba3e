"""What packets do not say: metadata and calibrations, from files or asked of the sensor. Opens files and sockets."""

from __future__ import annotations

import socket
import urllib.request
from http.client import HTTPException, InvalidURL
from itertools import islice
from pathlib import Path

from common.clock import monotonic_s
from common.config import ConfigError
from common.source_url import SourceUrl
from services.infra_lidar.input import robosense
from services.infra_lidar.input.captures import read_capture
from services.infra_lidar.input.hesai_calibration import (
    CHANNELS,
    CalibrationError,
    as_metadata,
    read_calibration,
    read_firetimes,
    with_firetimes,
)
from services.infra_lidar.input.hesai_commands import ask_calibration
from services.infra_lidar.input.models import kind_of
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.ouster_metadata import MetadataError
from services.infra_lidar.input.sensors import HESAI_MODELS, Sender

DIFOP_PORT, DIFOP_WAIT_S = 7788, 3.0  # the sensor sends one each second
DIFOP_WITHIN = 20_000  # packets of a capture: some seconds


def captured_metadata(sender: Sender, path: Path, url: SourceUrl) -> str:
    """The metadata that a sensor's packets in a capture need: from files that the source names, beside it, or from it.

    Raises:
        ConfigError: there is no such file, or it is not of such a sensor.
    """
    kind = kind_of(sender.model)
    if kind == "ouster":
        return read_ouster(Path(url.params.get("metadata", beside(path, ".json"))), url)
    if kind == "hesai":
        return read_hesai(url, beside(path, ".csv"), sender.model)
    if kind == "robosense":
        if "calibration" in url.params or beside(path, ".csv").exists():
            return read_robosense(url, Path(url.params.get("calibration", beside(path, ".csv"))))
        return _captured_angles(sender, path, url)
    return ""


def named_metadata(url: SourceUrl) -> str | None:
    """The metadata that a live source needs, from the files that it names; None = the sensor has to be asked.

    Raises:
        ConfigError: there is no such file, it is not of such a sensor, or the port to ask at is none.
    """
    if url.scheme == "ouster":
        return read_ouster(Path(url.params["metadata"]), url) if "metadata" in url.params else None
    if url.scheme == "hesai":
        _firetimes(url)  # a wrong file is told before the sensor is asked
        return read_hesai(url, None) if "calibration" in url.params else None
    if url.scheme == "robosense":
        _difop_port(url)
        return read_robosense(url, Path(url.params["calibration"])) if "calibration" in url.params else None
    return ""


def asked_metadata(url: SourceUrl) -> str:
    """The metadata that a live source needs, asked of the sensor that it names.

    Raises:
        ConfigError: the sensor does not answer, or not with its metadata.
    """
    return {"ouster": _ask_ouster, "hesai": _ask_hesai, "robosense": _heard_angles}[url.scheme](url)


def beside(path: Path, suffix: str) -> Path:
    """``NAME`` with that suffix, of ``NAME.pcap`` or ``NAME.pcap.gz``; ``NAME`` may have dots, such as a date has."""
    name = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    return name.with_suffix(suffix)


def read_ouster(path: Path, url: SourceUrl) -> str:
    """Ouster metadata from a file.

    Raises:
        ConfigError: it cannot be read, or is no metadata of a lidar that is supported.
    """
    try:
        return OusterFormat(path.read_text(encoding="utf-8")).metadata
    except OSError as error:
        raise ConfigError(f"source {url}: no Ouster metadata: {error}; give it with ?metadata=FILE") from None
    except (UnicodeError, MetadataError) as error:
        raise ConfigError(f"source {url}: {path}: {error}") from None


def read_hesai(url: SourceUrl, default: Path | None, model: str = "") -> str:
    """Metadata of the files ``calibration`` (or ``default``) and ``firetimes`` of the source, for packets of ``model``.

    Raises:
        ConfigError: there is no calibration, or a file is not of such a sensor.
    """
    angles = Path(url.params["calibration"]) if "calibration" in url.params else default
    if angles is None or not (angles.exists() or "calibration" in url.params):
        raise ConfigError(
            f"source {url}: Hesai packets hold no beam angles: give the sensor's own angle correction file with "
            f"?calibration=FILE (the sensor's web page or PandarView saves it)"
        )
    try:
        angles_text = angles.read_text(encoding="utf-8-sig")
        read_calibration(angles_text)
    except (OSError, UnicodeError, CalibrationError) as error:
        raise ConfigError(f"source {url}: {angles}: {error}") from None
    return as_metadata(angles_text, _firetimes(url, model))


def _firetimes(url: SourceUrl, model: str = "") -> str:
    """The text of the file ``firetimes`` of the source; "" = it names none.

    Raises:
        ConfigError: it cannot be read, or is not of such a sensor.
    """
    if "firetimes" not in url.params:
        return ""
    path = Path(url.params["firetimes"])
    try:
        text = path.read_text(encoding="utf-8-sig")
        _, protocol = read_firetimes(text)
        if model and HESAI_MODELS[*protocol, CHANNELS] != model:
            raise CalibrationError(f"firing times of {HESAI_MODELS[*protocol, CHANNELS]}, packets of {model}")
    except (OSError, UnicodeError, CalibrationError) as error:
        raise ConfigError(f"source {url}: {path}: {error}") from None
    return text


def read_robosense(url: SourceUrl, path: Path) -> str:
    """Metadata of a file of angles.

    Raises:
        ConfigError: it cannot be read, or is no file of a Ruby's angles.
    """
    try:
        return robosense.as_metadata(robosense.read_angle_file(path.read_text(encoding="utf-8-sig")))
    except (OSError, UnicodeError, CalibrationError) as error:
        raise ConfigError(f"source {url}: {path}: {error}") from None


def _captured_angles(sender: Sender, path: Path, url: SourceUrl) -> str:
    """Metadata of the sensor's first DIFOP packet in the capture."""
    with path.open("rb") as stream:
        for datagram in islice(read_capture(stream), DIFOP_WITHIN):
            if datagram.sender == sender.address and robosense.is_difop(datagram.payload):
                try:
                    return robosense.as_metadata(robosense.read_difop(datagram.payload))
                except CalibrationError as error:
                    raise ConfigError(f"source {url}: {path}: DIFOP packet: {error}") from None
    raise ConfigError(
        f"source {url}: {path}: no DIFOP packet, which holds the beam angles, among {DIFOP_WITHIN} packets: record the "
        f"sensor's DIFOP port ({DIFOP_PORT}) too, or give its angles with ?calibration=FILE"
    )


def _heard_angles(url: SourceUrl) -> str:
    """Metadata of the first DIFOP packet that comes, of the host that the source names if it names one."""
    port, host = _difop_port(url), url.target
    until_s = monotonic_s() + DIFOP_WAIT_S
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.bind(("", port))
            if "group" in url.params:
                group = socket.inet_aton(url.params["group"]) + bytes(4)
                receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
            while (left_s := until_s - monotonic_s()) > 0.0:
                receiver.settimeout(left_s)
                packet, (address, *_) = receiver.recvfrom(65536)
                if robosense.is_difop(packet) and (not host or address == socket.gethostbyname(host)):
                    return robosense.as_metadata(robosense.read_difop(packet))
    except TimeoutError:
        pass
    except (OSError, CalibrationError) as error:
        raise ConfigError(f"source {url}: DIFOP packets on UDP port {port}: {error}") from None
    raise ConfigError(
        f"source {url}: no DIFOP packet, which holds the beam angles, on UDP port {port} within {DIFOP_WAIT_S:.0f} s; "
        f"the sensor's own port is ?difop=PORT, or give its angles with ?calibration=FILE"
    )


def _difop_port(url: SourceUrl) -> int:
    return url.port("difop", DIFOP_PORT)


def _ask_ouster(url: SourceUrl) -> str:
    address = f"http://{url.target}/api/v1/sensor/metadata"
    try:
        with urllib.request.urlopen(address, timeout=5.0) as reply:
            return OusterFormat(reply.read().decode("utf-8")).metadata
    except (HTTPException, OSError, ValueError) as error:
        wrong = isinstance(error, HTTPException) and not isinstance(error, InvalidURL)
        what = f"no whole HTTP answer ({str(error).strip():.60})" if wrong else error
        raise ConfigError(f"source {url}: no metadata from {address}: {what}; give a file: ?metadata=FILE") from None


def _ask_hesai(url: SourceUrl) -> str:
    try:
        calibration, times = ask_calibration(url.target), _firetimes(url)
        return with_firetimes(calibration, times) if times else calibration
    except (OSError, CalibrationError) as error:
        raise ConfigError(
            f"source {url}: no calibration from {url.target or 'the sensor'}: {error}; give a file: ?calibration=FILE"
        ) from None
