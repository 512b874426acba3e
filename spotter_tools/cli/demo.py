"""`spotter demo`: the whole system on this machine, in the simulated world, with the dashboard."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import signal
import sys
import tempfile
from dataclasses import dataclass
from typing import Annotated

import typer

from common.bus.namespace import DEMO
from common.bus.service_app import setup_logging
from common.bus.session import close_session, init_zenoh_log, open_session, refuse_malformed
from common.config import ConfigError, ZenohConfig
from common.host.process_plan import Plan, children, parse_settings
from common.host.supervisor import Supervisor
from common.topics import OPTIONAL_SERVICES, SERVICES, SERVICES_OF_ANY_HOST, ServiceRow
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, Namespace
from spotter_tools.cli.fail import fail
from spotter_tools.cli.up import sim_sources
from spotter_tools.configurations import check_configurations
from spotter_tools.demo_monitor import DemoMonitor
from spotter_tools.ports import refuse_taken

START_BUDGET_S = 90.0  # a cold compile cache takes a while; after this the measurement begins anyhow
POLL_S = 0.1


def demo_rows() -> list[ServiceRow]:
    """Every service of the table; the blackbox too, where recording is installed (extra ``record`` or ``laptop``)."""
    recorder = SERVICES_OF_ANY_HOST if importlib.util.find_spec("mcap") else ()
    return [*SERVICES, *OPTIONAL_SERVICES, *recorder]


ROWS = demo_rows()


@dataclass(frozen=True)
class DemoOptions:
    """What the command line of the demo says."""

    scenario: str
    seconds: float
    as_json: bool
    port: int
    plan: Plan


def demo(
    scenario: Annotated[str, typer.Option(help="crossing, empty, faults, drive or emergency.")] = "crossing",
    seconds: Annotated[
        float, typer.Option(min=0.0, help="Stop by itself after this long, counted from when all are up.")
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object at the end and nothing else.")] = False,
    listen: Annotated[str, typer.Option(help="Where the demo's router listens.")] = DEFAULT_ENDPOINT,
    port: Annotated[int, typer.Option(min=1, max=65535, help="The dashboard's port on 127.0.0.1.")] = 8080,
    overrides: Annotated[list[str] | None, typer.Option("--set", help="SERVICE.section.key=value.")] = None,
    namespace: Namespace = DEMO,
) -> None:
    """Router, services and dashboard on this machine; no hardware needed. Ctrl-C stops all of it."""
    setup_logging("demo")
    init_zenoh_log(None)
    with tempfile.TemporaryDirectory(prefix="spotter-demo-") as incidents:
        settings = [f"blackbox.folder={incidents}", f"fusion.store={incidents}/fusion", *(overrides or [])]
        plan = _checked_plan(scenario, listen, port, namespace, settings)
        code = asyncio.run(_run(DemoOptions(scenario, seconds, as_json, port, plan)))
    raise SystemExit(code)


def _checked_plan(scenario: str, listen: str, port: int, namespace: str, overrides: list[str]) -> Plan:
    """The plan, with every configuration loaded once and every port found free; ends the command when it cannot be."""
    try:
        plan = _plan(scenario, listen, port, namespace, overrides)
        check_configurations(ROWS, plan)
        refuse_taken(listen, "something runs here already; a demo beside it: --listen tcp/127.0.0.1:7448 --port 8081")
        refuse_malformed(listen)
        refuse_taken(f"tcp/127.0.0.1:{port}", "another page is served there; choose another one with --port")
    except ConfigError as error:
        fail(str(error), code=2)
    return plan


def _plan(scenario: str, listen: str, port: int, namespace: str, overrides: list[str]) -> Plan:
    settings = {name: list(texts) for name, texts in parse_settings(overrides).items()}
    settings.setdefault("dashboard", []).insert(0, f"server.port={port}")
    settings.setdefault("fusion", []).insert(0, "roadside.enabled=true")
    settings.setdefault("gate", [])[:0] = ['outputs=["sim:"]', 'accept=["live", "simulated"]']
    return Plan(
        listen=(listen,),
        namespace=namespace,
        sources=sim_sources(ROWS, scenario),
        settings={name: tuple(texts) for name, texts in settings.items()},
    )


async def _run(options: DemoOptions) -> int:
    supervisor = Supervisor(children(ROWS, options.plan))
    loop = asyncio.get_running_loop()
    for signum in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(signum, supervisor.stop)
    running = asyncio.create_task(supervisor.run())
    watching = asyncio.create_task(_watch(options, supervisor, running))
    code = await running
    return await watching or code


async def _watch(options: DemoOptions, supervisor: Supervisor, running: asyncio.Task[int]) -> int:
    """Announce the dashboard, measure, stop after ``seconds``; returns the exit code of the measurement."""
    config = ZenohConfig(connect=options.plan.listen, namespace=options.plan.namespace)
    session = None
    while session is None and not running.done():
        try:
            session = await asyncio.to_thread(open_session, config, give_up_after_s=0.5)
        except ConnectionError:
            continue
    if session is None:
        return 0
    monitor = DemoMonitor(session)
    try:
        if not await _all_up(monitor, running):
            return 0
        sys.stderr.write(
            f"\n  Spotter is up. Dashboard: http://127.0.0.1:{options.port}   (Ctrl-C stops everything)\n\n"
        )
        monitor.restart()
        if not options.seconds:
            await asyncio.wait({running})
            return 0
        await asyncio.wait({running}, timeout=options.seconds)
        return _conclude(monitor, options)
    finally:
        supervisor.stop()
        await asyncio.to_thread(close_session, session)


async def _all_up(monitor: DemoMonitor, running: asyncio.Task[int]) -> bool:
    """Wait for the first message of every service; False when the demo ended before."""
    deadline_s = asyncio.get_running_loop().time() + START_BUDGET_S
    expected = {row.name for row in SERVICES}
    while monitor.services_online() != expected:
        if asyncio.get_running_loop().time() > deadline_s:
            missing = ", ".join(sorted(expected - monitor.services_online()))
            sys.stderr.write(f"spotter: still silent after {START_BUDGET_S:.0f} s: {missing}\n")
            return True
        done, _ = await asyncio.wait({running}, timeout=POLL_S)
        if done:
            return False
    return True


def _conclude(monitor: DemoMonitor, options: DemoOptions) -> int:
    report, silent = monitor.report(), monitor.silent_services()
    if options.as_json:
        print(json.dumps(report))
    else:
        rates = ", ".join(f"{name} {row['rate_hz']:g} Hz" for name, row in report["services"].items())
        print(f"{rates}; verdict {report['verdict']['rate_hz']:g} Hz, saw {report['verdict']['levels_seen']}")
    if silent:
        sys.stderr.write(f"spotter: published nothing: {', '.join(silent)}\n")
        return 1
    return 0
