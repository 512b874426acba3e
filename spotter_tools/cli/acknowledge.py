"""`spotter acknowledge`: a person confirms that what no sensor sees any more is gone."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus, one_host
from spotter_tools.cli.fail import fail

QUERY_TIMEOUT_S = 3.0


def acknowledge(
    fusion_host: Annotated[
        str, typer.Option(callback=one_host, help="The vehicle's host that runs fusion.")
    ] = "jetson0",
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    as_json: AsJson = False,
) -> None:
    """End the alarms that no sensor sees now and none can refute. On the vehicle's own host only: look first."""
    key = f"{fusion_host}/fusion/acknowledge"
    with bus(connect, namespace) as session:
        answers = [reply.ok for reply in session.get(key, timeout=QUERY_TIMEOUT_S) if reply.ok is not None]
    if not answers:
        fail(f"no fusion answers on {fusion_host}; from another host nobody may acknowledge")
    for answer in answers:
        said = answer.payload.to_string()
        print(json.dumps({"host": fusion_host, "answer": said}) if as_json else f"{fusion_host}: {said}")
