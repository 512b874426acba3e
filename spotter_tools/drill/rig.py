"""The system under test: a router, the services of the demo as processes, each behind a link that can be cut."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Collection
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Protocol

import zenoh

from common import topics
from common.bus.session import open_session
from common.clock import monotonic_s
from common.codec import DecodeError, decode
from common.config import ZenohConfig
from common.host.process_plan import Plan, router_child, service_child
from common.host.supervisor import Child
from common.messages import ServiceInfo
from common.topics import DATA_TOPICS, Topic, service_row
from services.jetson.gate.emulator import EmulatedActuator
from spotter_tools.drill.fault_plan import RELAYED, SIGNALS, Fault
from spotter_tools.drill.link_proxy import LinkProxy
from spotter_tools.drill.minded import Minded
from spotter_tools.drill.standin import UPSTREAM, StandIn

STOP_BUDGET_S = 5.0
SIM_WARM_UP_S = 4.0  # a service that starts this long before the fault has come online by then
START_BUDGET_S = 40.0
CLOCK_OFFSET = "SPOTTER_DRILL_CLOCK_OFFSET_S"
CLOCK_STEP_AFTER_S = 20.0  # the moment is given at the start: by then everything is in order and the clock measured
CLOCK_MEASURED_S = 3.0  # in order for at least this long before the step
ROUTER = "router"


class System(Protocol):
    """What a drill can be run against."""

    actuator: EmulatedActuator | None  # behind the gate; None if it is not observable

    def can(self, fault: Fault) -> bool:
        """Whether this fault is possible here."""

    def prepare(self, fault: Fault) -> None:
        """Make ready for the fault, still without it."""

    def inject(self, fault: Fault) -> float:
        """Break it; returns the monotonic time at which it is broken."""

    def heal(self, fault: Fault) -> None:
        """Mend it."""


class Rig:
    """Our own small demo: every fault is possible."""

    def __init__(self, port: int, scenario: str, log_dir: Path, services: tuple[str, ...]) -> None:
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self.actuator = EmulatedActuator() if "gate" in services else None
        self._scenario, self._log_dir, self._services = scenario, log_dir, services
        self._stack = ExitStack()
        self._processes: dict[str, subprocess.Popen[bytes] | Minded] = {}
        self._proxies: dict[str, LinkProxy] = {}
        self._stand_ins: dict[str, StandIn] = {}
        self._port = port
        self._step_at_s = 0.0
        self._stepped: set[str] = set()  # whose clock was left where the step put it

    def __enter__(self) -> Rig:
        try:
            self._start_all()
        except BaseException:  # if one cannot start, those before it are stopped
            self._end_all()
            raise
        return self

    def _start_all(self) -> None:
        if self.actuator is not None:
            self._stack.enter_context(self.actuator)
        self._start_router()
        config = ZenohConfig(connect=(self.endpoint,))
        self._session = self._stack.enter_context(open_session(config, give_up_after_s=START_BUDGET_S))
        for name in self._services:
            self._proxies[name] = LinkProxy(("127.0.0.1", self._port))
            self._stack.callback(self._proxies[name].close)
            self._start(name)

    def __exit__(self, *_: object) -> None:
        self._end_all()

    def _end_all(self) -> None:
        for name in list(self._stand_ins):
            self._stand_ins.pop(name).close()
        for name in reversed(list(self._processes)):  # the router last
            self._end(self._processes[name])
        self._stack.close()

    def can(self, fault: Fault) -> bool:
        """Every fault of a service that was started; the router can be killed and frozen."""
        return fault.service in self._services or (fault.service == ROUTER and fault.kind in SIGNALS)

    def prepare(self, fault: Fault) -> None:
        """Bring the service into the form that this fault needs, still without the fault."""
        if fault.kind in RELAYED and fault.service not in self._stand_ins:
            self._stop(fault.service)
            row = service_row(fault.service)
            self._stand_ins[row.name] = StandIn(row.name, row.host, _primary(row.name), self.endpoint, "spotter")
            self._start(fault.service, namespace=UPSTREAM)
        elif fault.kind not in RELAYED and fault.service in self._stand_ins:
            self._stop(fault.service)
            self._stand_ins.pop(fault.service).close()
            self._start(fault.service)
        elif fault.service in self._stepped and fault.kind != "clock_step":
            self._stepped.remove(fault.service)
            self._stop(fault.service)
            self._start(fault.service)
        if (fault.kind == "hang") != isinstance(self._processes[fault.service], Minded):
            self._stop(fault.service)
            self._start(fault.service, minded=fault.kind == "hang")
        if fault.kind == "clock_step":
            self._stepped.add(fault.service)
            self._stop(fault.service)
            self._step_at_s = monotonic_s() + CLOCK_STEP_AFTER_S
            self._start(fault.service, clock=f"{fault.seconds}@{self._step_at_s}")

    def inject(self, fault: Fault) -> float:
        """Break it; returns the monotonic time at which it was broken, which may be a moment ahead."""
        process = self._processes[fault.service]
        match fault.kind:
            case "kill":
                process.kill()
            case "freeze" | "hang":
                process.send_signal(signal.SIGSTOP)
            case "slow":
                self._proxies[fault.service].slow(fault.seconds)
            case "cut":
                self._proxies[fault.service].cut()
            case "clock":
                self._stop(fault.service)
                self._start(fault.service, clock=str(fault.seconds))
                return self._first_message(fault.service)
            case "clock_step":
                if monotonic_s() + CLOCK_MEASURED_S > self._step_at_s:
                    raise TimeoutError(
                        f"not in order {CLOCK_MEASURED_S:.0f} s before the clock of {fault.service} stepped"
                    )
                return self._step_at_s
            case "sim":
                self._stop(fault.service)
                self._start(fault.service, source=f"sim:faults?t0={fault.at_s - SIM_WARM_UP_S}")
                return self._first_message(fault.service) + SIM_WARM_UP_S
            case _:
                self._stand_ins[fault.service].injector.set(fault)
        return monotonic_s()

    def heal(self, fault: Fault) -> None:
        """Mend what ``inject`` broke, by a restart where it does not pass by itself."""
        match fault.kind:
            case "kill":
                self._processes[fault.service].wait()
                if fault.service == ROUTER:
                    self._start_router()
                else:
                    self._start(fault.service)
            case "freeze":
                self._processes[fault.service].send_signal(signal.SIGCONT)
            case "hang":
                pass  # that its supervisor replaces it has to be enough
            case "cut" | "slow":
                self._proxies[fault.service].heal()
            case "clock_step":
                pass  # the step stays; that it is measured and corrected has to be enough
            case "clock" | "sim":
                self._stop(fault.service)
                self._start(fault.service)
            case _:
                self._stand_ins[fault.service].injector.set(None)

    def _start_router(self) -> None:
        self._run(ROUTER, router_child(Plan(listen=(self.endpoint,))), dict(os.environ))

    def _start(
        self,
        name: str,
        *,
        source: str | None = None,
        namespace: str = "spotter",
        clock: str = "0",
        minded: bool = False,
    ) -> None:
        sources = {name: source or f"sim:{self._scenario}"} if name not in ("fusion", "dashboard", "gate") else {}
        settings = {}
        if self.actuator is not None:
            settings["gate"] = (f'outputs=["serial:{self.actuator.device}"]', 'accept=["live", "simulated"]')
        plan = Plan(listen=(self._proxies[name].endpoint,), namespace=namespace, sources=sources, settings=settings)
        child = service_child(service_row(name), plan)
        environment = {**(child.environment or os.environ), CLOCK_OFFSET: clock}
        if minded:
            child.environment = environment
            self._processes[name] = Minded(child, self._log_dir / f"{name}.log")
            return
        self._run(name, child, environment)

    def _run(self, name: str, child: Child, environment: dict[str, str]) -> None:
        with (self._log_dir / f"{name}.log").open("ab") as log:
            self._processes[name] = subprocess.Popen(
                child.command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def _stop(self, name: str) -> None:
        self._end(self._processes[name])

    def _end(self, process: subprocess.Popen[bytes] | Minded) -> None:
        process.terminate()
        process.send_signal(signal.SIGCONT)
        try:
            process.wait(STOP_BUDGET_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _first_message(self, name: str) -> float:
        """Monotonic time of the first data of a service that has just been started.

        Raises:
            TimeoutError: it did not come; the service's log says why.
        """
        arrived = threading.Event()
        key = _primary(name).key(service_row(name).host)
        subscriber = self._session.declare_subscriber(key, lambda _: arrived.set())
        try:
            if not arrived.wait(START_BUDGET_S):
                log = self._log_dir / f"{name}.log"
                raise TimeoutError(f"{name} published nothing within {START_BUDGET_S:.0f} s; see {log}")
            return monotonic_s()
        finally:
            subscriber.undeclare()


class Running:
    """A system that is already running: faults are possible only by signals to processes on this machine."""

    actuator: EmulatedActuator | None = None  # not observable on a running system

    def __init__(self, session: zenoh.Session, hosts: Collection[str] = ()) -> None:
        """``hosts``: those of the vehicle under test; may be empty if there is only one vehicle."""
        self._session, self._hosts = session, hosts
        self._frozen: dict[str, int] = {}

    def can(self, fault: Fault) -> bool:
        """Only signals, and only to a process on this machine."""
        return fault.kind in ("kill", "freeze") and self._pid(fault.service) is not None

    def prepare(self, fault: Fault) -> None:
        """Nothing to do: a running system is not changed."""
        return

    def inject(self, fault: Fault) -> float:
        """Send the signal; returns the monotonic time."""
        pid = self._pid(fault.service)
        if pid is None:
            raise TimeoutError(f"{fault.service} does not answer")
        if fault.kind == "freeze":
            self._frozen[fault.service] = pid
        os.kill(pid, signal.SIGKILL if fault.kind == "kill" else signal.SIGSTOP)
        return monotonic_s()

    def heal(self, fault: Fault) -> None:
        """Continue a frozen process; a killed one is restarted by its supervisor."""
        pid = self._frozen.pop(fault.service, None)
        if pid is not None:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)

    def _pid(self, service: str) -> int | None:
        """The process of a service, when it answers and runs on this machine under this user."""
        for reply in self._session.get(topics.info_key("*", service), timeout=1.0, target=zenoh.QueryTarget.ALL):
            if reply.ok is None:
                continue
            try:
                info = decode(reply.ok.payload.to_bytes(), ServiceInfo)
            except DecodeError:
                continue
            if self._hosts and info.host not in self._hosts:
                continue
            command = Path(f"/proc/{info.pid}/cmdline")
            if command.exists() and service_row(service).script.encode() in command.read_bytes():
                return info.pid
        return None


def _primary(service: str) -> Topic:
    """The topic that others decide on."""
    return next(t for t in DATA_TOPICS if t.service == service and t.age_limit_s is not None)
