"""Sources are URLs: ``sim:crossing?t0=3``, ``serial:/dev/ttyTHS1``, ``file:recordings/a.pcap?rate=2&loop=1``.

Live and recorded data are opened in the same way; each service's ``source.py`` opens the schemes it knows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from urllib.parse import parse_qsl

from common.config import ConfigError
from common.message_types import SOURCE_KINDS, SourceKind, least_live

_KIND_OF_SCHEME: dict[str, SourceKind] = {
    **dict.fromkeys(("serial", "spi", "csi", "v4l2", "gpio", "vesc", "can", "imu"), "live"),
    **dict.fromkeys(("velodyne", "ouster", "hesai", "robosense"), "live"),
    **dict.fromkeys(("file", "mcap"), "recorded"),
    "sim": "simulated",
}
HIGHEST_PORT = 65535
_EMULATOR = "emulator"  # `spi:emulator`: the device's own wire protocol, without the device


@dataclass(frozen=True)
class SourceUrl:
    """A parsed source: scheme, target (path, device, address or scenario) and parameters."""

    scheme: str
    target: str
    params: dict[str, str] = field(default_factory=dict)
    slashes: str = field(default="", compare=False)  # "//" where it was written before the target

    def number(self, name: str, default: float) -> float:
        """A numeric parameter; raises ``ConfigError`` when it is not a number, or not a finite one."""
        text = self.params.get(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            raise ConfigError(f"source {self}: {name}={text!r} is not a number") from None
        if not math.isfinite(value):
            raise ConfigError(f"source {self}: {name}={text!r} is not a finite number")
        return value

    def port(self, name: str, default: int) -> int:
        """A UDP or TCP port among the parameters; raises ``ConfigError`` when it is not one."""
        text = self.params.get(name)
        return default if text is None else port_in(text, f"source {self}: {name}")

    def flag(self, name: str) -> bool:
        """A yes/no parameter: 1, true or yes."""
        return self.params.get(name, "0").lower() in ("1", "true", "yes")

    def __str__(self) -> str:
        query = "&".join(f"{key}={value}" for key, value in self.params.items())
        return f"{self.scheme}:{self.slashes}{self.target}" + (f"?{query}" if query else "")


def port_in(text: str, where: str) -> int:
    """The UDP or TCP port that a text names. where: of the text, for the error.

    Raises:
        ConfigError: not a whole number from 1 to 65535.
    """
    if not text.isdecimal() or len(text) > 5 or not 1 <= int(text) <= HIGHEST_PORT:
        raise ConfigError(f"{where}: expected a port from 1 to {HIGHEST_PORT}, found {text!r}")
    return int(text)


def source_kind(source: str) -> SourceKind:
    """What data from this source URL is: measured now, replayed, or made up. A scheme that is not known is "unknown".

    Several URLs with ``" + "`` between them are as little live as the least of them. A service with a further scheme
    for a device adds it to the table above.
    """
    if " + " in source:
        return least_live(source_kind(one) for one in source.split(" + "))
    scheme, _, rest = source.partition(":")
    if scheme == "ros2":  # not visible in a topic: a simulator's and a played bag's look like a driver's
        given = dict(parse_qsl(rest.partition("?")[2])).get("kind", "live")
        return next((kind for kind in SOURCE_KINDS if kind == given), "unknown")
    if rest.removeprefix("//").partition("?")[0] == _EMULATOR:
        return "emulated"
    return _KIND_OF_SCHEME.get(scheme, "unknown")


def parse_source(text: str, allowed: dict[str, tuple[str, ...]]) -> SourceUrl:
    """Parse a source URL; ``allowed`` maps each scheme to the names of its parameters.

    Raises:
        ConfigError: no scheme, a scheme or parameter this service does not know.
    """
    scheme, colon, rest = text.partition(":")
    if not text:
        schemes = ", ".join(f"{name}:" for name in sorted(allowed))
        raise ConfigError(f"no source: give one with --source or `source` in the configuration; one of {schemes}")
    if not colon or scheme not in allowed:
        schemes = ", ".join(f"{name}:" for name in sorted(allowed))
        raise ConfigError(f"source {text!r}: expected one of {schemes}")
    target, _, query = rest.partition("?")
    params = dict(parse_qsl(query, keep_blank_values=True))
    for name in params:
        if name not in allowed[scheme]:
            known = ", ".join(allowed[scheme]) or "none"
            raise ConfigError(f"source {text!r}: no parameter {name!r} for {scheme}:; allowed: {known}")
    slashes = "//" if scheme != "file" and target.startswith("//") else ""
    return SourceUrl(scheme, target.removeprefix(slashes), params, slashes)
