"""`spotter drill`: break one thing at a time, check health and verdict against a written plan."""

from __future__ import annotations

import json
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from common.bus.vehicles import ROADSIDE, vehicles_on_bus
from common.config import ConfigError
from common.topics import ONBOARD_SENSORS
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, Connect, Namespace, bus
from spotter_tools.cli.fail import fail
from spotter_tools.drill.fault_plan import DEFAULT_FILE, DrillPlan, load_plan
from spotter_tools.drill.monitor import Watch
from spotter_tools.drill.rig import Rig, Running, System
from spotter_tools.drill.run import Result, report_lines, run_plan
from spotter_tools.ports import free_port

SERVICES_UNDER_DRILL = ("fusion", *ONBOARD_SENSORS, "gate")


def drill(
    file: Annotated[Path, typer.Option("--file", help="The plan: faults, expectations, deadlines.")] = DEFAULT_FILE,
    only: Annotated[str, typer.Option("--only", help="Run the drills whose name contains this.")] = "",
    running: Annotated[
        bool, typer.Option("--running", help="Drill the system at --connect with signals; without it a small demo.")
    ] = False,
    vehicle: Annotated[
        str, typer.Option("--vehicle", help="With --running: which vehicle, where there are several.")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object at the end.")] = False,
    list_only: Annotated[bool, typer.Option("--list", help="Name the drills and stop.")] = False,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
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
    results = _drill_running(plan, vehicle, connect, namespace) if running else _drill_demo(plan)
    if as_json:
        print(json.dumps({"ok": all(r.ok for r in results), "drills": msgspec.to_builtins(results)}))
    else:
        print("\n".join(report_lines(results)))
    raise SystemExit(0 if all(result.ok for result in results) else 1)


def _drill_running(plan: DrillPlan, vehicle: str, connect: str, namespace: str) -> list[Result]:
    with bus(connect, namespace) as session:
        hosts = _hosts_of(vehicle, vehicles_on_bus(session))
        watch = Watch(session, hosts)
        try:
            return _run(plan, Running(session, hosts), watch)
        finally:
            watch.close()


def _hosts_of(vehicle: str, vehicles: dict[str, str]) -> list[str]:
    """The hosts of the vehicle to be drilled; none where no vehicle has a name. Ends the command without a choice."""
    names = sorted(set(vehicles.values()) - {ROADSIDE})
    if vehicle and vehicle not in names:
        fail(f"--vehicle {vehicle}: no such vehicle on the bus; there is {', '.join(names) or 'none with a name'}", 2)
    if not vehicle and len(names) > 1:
        fail(f"there are several vehicles: choose one with --vehicle; there is {', '.join(names)}", code=2)
    return [host for host, name in vehicles.items() if name == (vehicle or "".join(names))] if names else []


def _drill_demo(plan: DrillPlan) -> list[Result]:
    """Against a router and services of our own, on a free port, with their logs in a folder that is named on a miss."""
    log_dir = Path(tempfile.mkdtemp(prefix="spotter-drill-"))
    with ExitStack() as stack:
        rig = stack.enter_context(Rig(free_port(), plan.scenario, log_dir, (*SERVICES_UNDER_DRILL, *plan.services)))
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
