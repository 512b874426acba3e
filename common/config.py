"""TOML file -> typed config. A wrong key or value stops the program before the first frame.

A config is a frozen ``msgspec.Struct`` whose fields all have defaults, so ``RadarConfig()`` is the shipped default.
Limits are stated with ``msgspec.Meta``. The message of a refusal names file, key, value and what is allowed::

    radar.toml: [cfar] threshhold_db = 16: no such key; did you mean 'threshold_db'? allowed: guard, threshold_db, ...
    radar.toml: [cfar] threshold_db = 90: expected a number <= 60
"""

from __future__ import annotations

import hashlib
import tomllib
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from common.config_errors import explain, unknown_key

C = TypeVar("C", bound=msgspec.Struct)
SECRETS = ("token", "password", "private_key")  # keys whose values are never published


class ConfigError(ValueError):
    """The configuration is wrong; the text says where, what and what is allowed."""


class Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every part of a configuration."""


class ZenohConfig(Section, frozen=True, kw_only=True):
    """How this process reaches the others. The defaults suit one machine with a router on loopback."""

    # The site: first chunk of every key, never spelled by code.
    namespace: typing.Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9_]*$")] = "spotter"
    mode: typing.Literal["client", "peer", "router"] = "client"
    connect: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    listen: tuple[str, ...] = ()
    lease_ms: typing.Annotated[int, msgspec.Meta(ge=100, le=60_000)] = 2000
    ca_certificate: str = ""  # PEM files; all three or none
    certificate: str = ""
    private_key: str = ""
    extra: dict[str, Any] = {}  # further Zenoh settings by path, e.g. "transport/link/tx/queue/size/data" = 4


class ServiceConfig(Section, frozen=True, kw_only=True):
    """What every service's configuration begins with."""

    host: typing.Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9_]+$")] = "localhost"  # the role, e.g. "pi0"
    source: str = ""
    zenoh: ZenohConfig = msgspec.field(default_factory=ZenohConfig)

    def check(self) -> None:
        """Checks across several keys that hold only once file and overrides are together. Raises ``ValueError``."""


def load(config_type: type[C], path: Path | None = None, overrides: Iterable[str] = ()) -> C:
    """Read the file, lay ``section.key=value`` overrides over it, and check everything.

    Raises:
        ConfigError: unreadable, unknown key, wrong type, value outside its limits.
    """
    overrides = list(overrides)
    document, origin = _read(path) if path else ({}, "defaults")
    config = _convert(config_type, document, origin)
    for override in overrides:
        key, value = _parse_override(override)
        _refuse_unknown(config_type, _nest(key, value), "--set")
        _assign(document, key, value)
    if overrides:  # together: two keys that need each other may come in either order
        config = _convert(config_type, document, "--set")
    if isinstance(config, ServiceConfig):
        try:
            config.check()
        except ValueError as error:
            raise ConfigError(f"{path or 'defaults'}{' with --set' if overrides else ''}: {error}") from None
    return config


def _convert(config_type: type[C], document: Mapping[str, Any], origin: str) -> C:
    _refuse_unknown(config_type, document, origin)
    document = _completed(document, config_type())
    try:
        return msgspec.convert(document, config_type)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{origin}: {explain(error, document, config_type)}") from None
    except ValueError as error:  # a __post_init__ check across several keys
        raise ConfigError(f"{origin}: {error}") from None


def _completed(document: Mapping[str, Any], defaults: msgspec.Struct) -> dict[str, Any]:
    """A key that a section leaves out has the default of that very section, not of the section's class.

    ``[sensors.lidar] host = "pi1"`` leaves the lidar's own ``budget_ms`` as it is.
    """
    completed = dict(document)
    for field in msgspec.structs.fields(type(defaults)):
        default, given = getattr(defaults, field.name), document.get(field.encode_name)
        if isinstance(default, msgspec.Struct) and isinstance(given, Mapping):
            completed[field.encode_name] = {**msgspec.to_builtins(default), **_completed(given, default)}
    return completed


def config_hash(config: msgspec.Struct) -> str:
    """Twelve hex digits that identify an effective configuration."""
    canonical = msgspec.json.encode(msgspec.to_builtins(config), order="sorted")
    return hashlib.sha256(canonical).hexdigest()[:12]


def public(config: msgspec.Struct) -> dict[str, Any]:
    """The effective configuration as a plain mapping, without how the bus is reached and without secrets."""
    document = typing.cast(dict[str, Any], msgspec.to_builtins(config))
    return {key: _without_secrets(value) for key, value in document.items() if key != "zenoh"}


def _without_secrets(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: "" if key in SECRETS else _without_secrets(inner) for key, inner in value.items()}


def _read(path: Path) -> tuple[dict[str, Any], str]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")), str(path)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder, expected a TOML file") from None
    except PermissionError:
        raise ConfigError(f"{path}: not readable by this user") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def _parse_override(text: str) -> tuple[list[str], Any]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"--set {text!r}: expected section.key=value")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value  # a bare word is a string, so that paths and URLs need no quotes
    return key.strip().split("."), parsed


def _nest(key: list[str], value: Any) -> dict[str, Any]:
    nested: Any = value
    for part in reversed(key):
        nested = {part: nested}
    return typing.cast(dict[str, Any], nested)


def _assign(document: dict[str, Any], key: list[str], value: Any) -> None:
    for part in key[:-1]:
        nested = document.setdefault(part, {})
        if not isinstance(nested, dict):
            raise ConfigError(f"--set {'.'.join(key)}: {part} is a value, not a section")
        document = nested
    document[key[-1]] = value


def _refuse_unknown(
    config_type: type[msgspec.Struct], document: Mapping[str, Any], origin: str, path: str = ""
) -> None:
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(config_type)}
    for key, value in document.items():
        if key not in fields:
            raise ConfigError(f"{origin}: {unknown_key(key, value, sorted(fields), path)}")
        nested, where = _struct_in(fields[key]), f"{path}.{key}" if path else key
        if nested is None or not isinstance(value, Mapping):
            continue
        if typing.get_origin(fields[key]) is dict:  # a table of structs under names of the user's choice
            for name, entry in value.items():
                if isinstance(entry, Mapping):
                    _refuse_unknown(nested, entry, origin, f"{where}.{name}")
        else:
            _refuse_unknown(nested, value, origin, where)


def _struct_in(hint: Any) -> type[msgspec.Struct] | None:
    for candidate in (hint, *typing.get_args(hint)):
        if isinstance(candidate, type) and issubclass(candidate, msgspec.Struct):
            return candidate
    return None
