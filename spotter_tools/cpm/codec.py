"""Collective Perception Messages as bytes: UPER by the library ``asn1tools`` (extra ``cpm``). Pure."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import Any

import asn1tools

MODULE = Path(__file__).parent / "cpm.asn"
CONTAINERS = {2: "OriginatingRsuContainer", 3: "SensorInformationContainer", 5: "PerceivedObjectContainer"}
Json = dict[str, Any]


class CpmError(ValueError):
    """A message that cannot be written or read; the text says where."""


@cache
def _specification() -> Any:
    return asn1tools.compile_files(str(MODULE), "uper")


def encode(message: Json) -> bytes:
    """A message with its containers by number, ``{"header", "managementContainer", "containers": {2: ...}}``.

    Raises:
        CpmError: a value outside of its range; the text names the field.
    """
    write = partial(_specification().encode, check_constraints=True)
    try:
        wrapped = [
            {"containerId": number, "containerData": bytes(write(CONTAINERS[number], content))}
            for number, content in message["containers"].items()
        ]
        payload = {"managementContainer": message["managementContainer"], "cpmContainers": wrapped}
        return bytes(write("CollectivePerceptionMessage", {"header": message["header"], "payload": payload}))
    except (asn1tools.EncodeError, asn1tools.ConstraintsError, KeyError) as error:
        raise CpmError(str(error)) from None


def decode(data: bytes) -> Json:
    """The same back. Containers that a roadside host does not send are left as bytes.

    Raises:
        CpmError: no such message, or with content that our module does not have.
    """
    specification = _specification()
    try:
        message = specification.decode("CollectivePerceptionMessage", data)
        containers = {
            one["containerId"]: specification.decode(CONTAINERS[one["containerId"]], one["containerData"])
            if one["containerId"] in CONTAINERS
            else one["containerData"]
            for one in message["payload"]["cpmContainers"]
        }
    except (asn1tools.DecodeError, IndexError, ValueError, NotImplementedError) as error:
        raise CpmError(str(error)) from None
    return {
        "header": message["header"],
        "managementContainer": message["payload"]["managementContainer"],
        "containers": containers,
    }
