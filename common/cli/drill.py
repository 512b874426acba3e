"""`spotter drill`: break one thing at a time, check health and verdict against a written plan."""

from __future__ import annotations

import json
import socket
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from common.cli.connect import DEFAULT_ENDPOINT, Connect, Namespace, bus
from common.cli.fail import fail
from common.config import ConfigError
from common.drill.plan import DEFAULT_FILE, DrillPlan, load_plan
from common.drill.rig import Rig, Running, System
from common.drill.run import Result, report_lines, run_plan
from common.drill.watch import Watch

SERVICES_UNDER_DRILL = ("fusion", "lidar", "radar", "camera")


def drill(
    file: Annotated[Path, typer.Option("--file", help="The plan: faults, expectations, deadlines.")] = DEFAULT_FILE,
    only: Annotated[str, typer.Option("--only", help="Run the drills whose name contains this.")] = "",
    running: Annotated[
        bool, typer.Option("--running", help="Drill the system at --connect with signals; without it a small demo.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object at the end.")] = False,
    list_only: Annotated[bool, typer.Option("--list", help="Name the drills and stop.")] = False,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "spotter",
) -> None:
    """Run fault drills; exits with 1 when a deadline was missed or a verdict was wrong."""
    try:
        plan = load_plan(file, only)
    except ConfigError as error:
        fail(str(error), code=2)
    if list_only:
        for one in plan.drills:
            print(one.name)
        return
    results = _drill_running(plan, connect, namespace) if running else _drill_demo(plan)
    if as_json:
        print(json.dumps({"ok": all(r.ok for r in results), "drills": msgspec.to_builtins(results)}))
    else:
        print("\n".join(report_lines(results)))
    raise SystemExit(0 if all(result.ok for result in results) else 1)


def add_drill(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(drill)


def _drill_running(plan: DrillPlan, connect: str, namespace: str) -> list[Result]:
    with bus(connect, namespace) as session:
        watch = Watch(session)
        try:
            return _run(plan, Running(session), watch)
        finally:
            watch.close()


def _drill_demo(plan: DrillPlan) -> list[Result]:
    """Against a router and services of our own, on a free port, with their logs in a folder that is named on a miss."""
    log_dir = Path(tempfile.mkdtemp(prefix="spotter-drill-"))
    with ExitStack() as stack:
        rig = stack.enter_context(Rig(_free_port(), plan.scenario, log_dir, SERVICES_UNDER_DRILL))
        session = stack.enter_context(bus(rig.endpoint, "spotter"))
        watch = Watch(session)
        stack.callback(watch.close)
        results = _run(plan, rig, watch)
    if not all(result.ok for result in results):
        sys.stderr.write(f"spotter: the services' logs are in {log_dir}\n")
    return results


def _run(plan: DrillPlan, system: System, watch: Watch) -> list[Result]:
    results = []
    for result in run_plan(plan, system, watch):
        results.append(result)
        mark = "skip" if result.skipped else "ok" if result.ok else "MISS"
        sys.stderr.write(f"{mark:<5}{result.name}\n")
        sys.stderr.flush()
    return results


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
