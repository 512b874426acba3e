"""`spotter gate status | acknowledge | try`: gate state, operator acknowledgement, wiring test."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Annotated

import msgspec
import typer
import zenoh

from common.codec import DecodeError, decode
from common.config import ConfigError, load
from common.messages import GateState
from common.topics import GATE_STATE
from services.jetson.gate.config import GateConfig
from services.jetson.gate.output import Output, open_outputs
from services.jetson.gate.trial import Finding, Step, steps_of, trial
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace, bus
from spotter_tools.cli.fail import fail

STATE_WITHIN_S = 2.0
NO_GATE = "no gate answers; is spotter-gate running on the vehicle's host?"

app = typer.Typer(name="gate", help="The gate between fusion's verdict and the actuator.", no_args_is_help=True)


@app.command()
def status(connect: Connect = DEFAULT_ENDPOINT, namespace: Namespace = "", as_json: AsJson = False) -> None:
    """What the gate tells the actuator now, and why; exits with 1 when no gate publishes."""
    with bus(connect, namespace) as session:
        states = _states(session)
    if not states:
        fail(NO_GATE)
    for host, state in sorted(states.items()):
        if as_json:
            print(json.dumps({"host": host, **msgspec.to_builtins(state)}))
        else:
            print("\n".join(lines_of(host, state)))


@app.command()
def acknowledge(connect: Connect = DEFAULT_ENDPOINT, namespace: Namespace = "", as_json: AsJson = False) -> None:
    """Say that you have looked and the vehicle may move again. Counts only while nothing else stops it."""
    with bus(connect, namespace) as session:
        replies = [reply.ok for reply in session.get("*/gate/acknowledge", timeout=STATE_WITHIN_S) if reply.ok]
    if not replies:
        fail(f"{NO_GATE} With TLS only programs on that host may acknowledge")
    for reply in replies:
        host, said = str(reply.key_expr).partition("/")[0], json.loads(reply.payload.to_bytes())
        if as_json:
            print(json.dumps({"host": host, **said}))
        elif said["counts"]:
            print(f"{host}: acknowledged")
        else:
            print(f"{host}: does not count now: {said['permission']} ({said['cause']}): {said['because']}")


@app.command("try")
def try_wiring(
    output: Annotated[str, typer.Option("--output", help="One of the gate's outputs, e.g. serial:/dev/ttyACM0.")] = "",
    config: Annotated[
        Path | None, typer.Option("--config", help="The gate's TOML file: its outputs and speeds.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.2, max=60.0, help="How long SLOW and GO last.")] = 3.0,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether the wheels are off the ground.")] = False,
    as_json: AsJson = False,
) -> None:
    """Try the wiring with the wheels off the ground; the gate's service must not run. Exits with 1 after a miss."""
    try:
        settings = [f"outputs={json.dumps([output])}"] if output else []
        loaded = load(GateConfig, config, settings)
        outputs = open_outputs(loaded)
    except ConfigError as error:
        fail(str(error), code=2)
    if not outputs:
        fail("nothing to try: name an --output, or a --config with `outputs`", code=2)
    if not yes:
        typer.confirm("The wheels are going to turn. Is the vehicle jacked up, wheels off the ground?", abort=True)
    missed = [_try(one, steps_of(loaded, seconds), as_json) for one in outputs]
    raise SystemExit(1 if any(missed) else 0)


def _try(output: Output, steps: tuple[Step, ...], as_json: bool) -> bool:
    """Whether anything was missed."""
    missed = False

    def show(step: Step) -> None:
        if not as_json:
            print(f"{step.name:<8} {step.look}", flush=True)

    for finding in trial(output, steps, show):
        text, miss = outcome(finding)
        missed |= miss
        print(json.dumps({"output": str(output.url), **finding._asdict()}) if as_json else f"         {text}")
    return missed


def outcome(finding: Finding) -> tuple[str, bool]:
    """A sentence about one step, and whether it is a miss."""
    if finding.fault and not (finding.name == "silence" and "stopped by itself" in finding.fault):
        return f"MISS: {finding.fault}", True
    if not finding.words:
        return "this output has no way to answer: believe your eyes", False
    if finding.after_s is None:
        return f"MISS: the actuator says {finding.words}", True
    return f"the actuator says {finding.words}, after {finding.after_s:.2f} s", False


def lines_of(host: str, state: GateState) -> list[str]:
    """For people."""
    limit = f", at most {state.limit_mps:g} m/s" if state.permission != "STOP" else ""
    lines = [f"{host}: {state.permission}{limit} ({state.cause}): {state.because}"]
    if state.left_s:
        lines.append(f"  needs {state.left_s:.1f} s of good verdicts")
    if state.acknowledge:
        lines.append("  a person has to acknowledge: spotter gate acknowledge, or the button")
    if state.verdict_age_s is not None:
        lines.append(f"  verdict {state.verdict_seq}, {state.verdict_age_s * 1e3:.0f} ms old, {state.source_kind} data")
    lines += [f"  {url}: {words}" for url, words in state.outputs.items()]
    return [*lines, f"  {state.state}: {state.reason}"] if state.reason else lines


def _states(session: zenoh.Session) -> dict[str, GateState]:
    """The newest state of every gate that publishes, by host."""
    states: dict[str, GateState] = {}
    arrived = threading.Event()

    def take(sample: zenoh.Sample) -> None:
        try:
            state = decode(sample.payload.to_bytes(), GateState)
        except DecodeError:
            return
        states[str(sample.key_expr).partition("/")[0]] = state
        arrived.set()

    subscriber = session.declare_subscriber(GATE_STATE.any_host, take)
    if arrived.wait(STATE_WITHIN_S):
        threading.Event().wait(0.3)  # of further vehicles
    subscriber.undeclare()
    return states
