"""Error texts for a configuration: section, key, value, and what is allowed."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import Any

import msgspec
import msgspec.inspect

Document = Mapping[str, Any]
_ANY_NAME = "..."  # how msgspec writes a name of the user's choice, such as a host's


def unknown_key(key: str, value: Any, known: list[str], path: str) -> str:
    """A key that does not exist, and which one may have been meant."""
    where = f"[{path}] " if path else ""
    near = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    shown = "{...}" if isinstance(value, Mapping) else repr(value)
    return f"{where}{key} = {shown}: no such key; {hint}allowed: {', '.join(known)}"


def explain(error: msgspec.ValidationError, document: Document, config_type: type[msgspec.Struct]) -> str:
    """msgspec's text and path as ours, with the value that is wrong."""
    text, _, path = str(error).partition(" - at `")
    if text.partition(" ")[0].isalpha():  # a sentence of msgspec's; our own may begin with a key, such as T_map_sensor
        text = text[0].lower() + text[1:]
    if path.startswith("key`"):  # a name of the user's choice that may not be used
        table, place = document, [*re.findall(r"[\w.]+", path.rpartition("$")[2].replace(".", " ")), _ANY_NAME]
        return f"[{'.'.join(_named(place, table, config_type, str(error)))}] {text}"
    parts = re.findall(r"\.{3}|[^.\[\]`$]+", path)
    parts = _named(parts, document, config_type, str(error))
    value: Any = document
    for part in parts:
        value = value[int(part)] if isinstance(value, list) else value.get(part)
    if isinstance(value, Mapping):  # a whole section is too long to print
        return f"[{'.'.join(parts)}] {text}" if parts else text
    section, choices = ".".join(parts[:-1]), _choices(parts, config_type)
    allowed = f"; allowed: {', '.join(choices)}" if choices and text.startswith("invalid enum value") else ""
    return f"{f'[{section}] ' if section else ''}{parts[-1]} = {value!r}: {text}{allowed}"


def _choices(parts: list[str], config_type: type[msgspec.Struct]) -> list[str]:
    """What may stand at a place of the configuration, where it is one of a few values."""
    kinds: list[Any] = [msgspec.inspect.type_info(config_type)]
    for part in parts:
        kinds = [inside for kind in kinds for inside in _inside(kind, part)]
    return [repr(value) for kind in kinds for value in getattr(kind, "values", ())]


def _inside(kind: Any, part: str) -> list[Any]:
    """The types of one entry of a section, a list or a table; all that it may be."""
    match kind:
        case msgspec.inspect.StructType():
            found = [field.type for field in kind.fields if field.encode_name == part]
        case msgspec.inspect.DictType():
            found = [kind.value_type]
        case msgspec.inspect.ListType() | msgspec.inspect.VarTupleType():
            found = [kind.item_type]
        case msgspec.inspect.TupleType():
            found = [kind.item_types[int(part)]]
        case _:
            found = []
    return [one for type_ in found for one in getattr(type_, "types", (type_,))]


def _named(parts: list[str], document: Document, config_type: type[msgspec.Struct], error_text: str) -> list[str]:
    """The path with the names of the user's choice filled in: of the entry that alone gives the same error."""
    while _ANY_NAME in parts:
        place = parts[: parts.index(_ANY_NAME)]
        table: Any = document
        for part in place:
            table = table[part]
        for name in table:
            reduced = _only(document, [*place, name])
            if _error_text(reduced, config_type) == error_text:
                parts, document = [*place, name, *parts[len(place) + 1 :]], reduced
                break
        else:
            return parts
    return parts


def _only(document: Document, place: list[str]) -> Document:
    """The document with one entry left in the table that ``place`` leads into."""
    first, *rest = place
    if not rest:
        return {first: document[first]}
    return {**document, first: _only(document[first], rest)}


def _error_text(document: Document, config_type: type[msgspec.Struct]) -> str:
    try:
        msgspec.convert(document, config_type)
    except msgspec.ValidationError as error:
        return str(error)
    return ""
