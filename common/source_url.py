"""Sources are URLs: ``sim:crossing?t0=3``, ``serial:/dev/ttyTHS1``, ``file:recordings/a.pcap?rate=2&loop=1``.

Live and recorded data come through the same door; each service's ``source.py`` opens the schemes it knows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from urllib.parse import parse_qsl

from common.config import ConfigError


@dataclass(frozen=True)
class SourceUrl:
    """A parsed source: scheme, target (path, device, address or scenario) and parameters."""

    scheme: str
    target: str
    params: dict[str, str] = field(default_factory=dict)

    def number(self, name: str, default: float) -> float:
        """A numeric parameter; raises ``ConfigError`` when it is not a number."""
        text = self.params.get(name)
        if text is None:
            return default
        try:
            return float(text)
        except ValueError:
            raise ConfigError(f"source {self}: {name}={text!r} is not a number") from None

    def flag(self, name: str) -> bool:
        """A yes/no parameter: 1, true or yes."""
        return self.params.get(name, "0").lower() in ("1", "true", "yes")

    def __str__(self) -> str:
        query = "&".join(f"{key}={value}" for key, value in self.params.items())
        return f"{self.scheme}:{self.target}" + (f"?{query}" if query else "")


def parse_source(text: str, allowed: dict[str, tuple[str, ...]]) -> SourceUrl:
    """Parse a source URL; ``allowed`` maps each scheme to the names of its parameters.

    Raises:
        ConfigError: no scheme, a scheme or parameter this service does not know.
    """
    scheme, colon, rest = text.partition(":")
    if not colon or scheme not in allowed:
        schemes = ", ".join(f"{name}:" for name in sorted(allowed))
        raise ConfigError(f"source {text!r}: expected one of {schemes}")
    target, _, query = rest.partition("?")
    params = dict(parse_qsl(query, keep_blank_values=True))
    for name in params:
        if name not in allowed[scheme]:
            known = ", ".join(allowed[scheme]) or "none"
            raise ConfigError(f"source {text!r}: no parameter {name!r} for {scheme}:; allowed: {known}")
    target = target.removeprefix("//") if scheme != "file" else target
    return SourceUrl(scheme, target, params)
