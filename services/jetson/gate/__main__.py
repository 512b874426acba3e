"""Permission to move, from fusion's verdict to the actuator: GO, SLOW with a speed limit, or STOP."""

from __future__ import annotations

import os
from contextlib import ExitStack

from common.bus.runtime import Service
from common.bus.service_app import service_app
from common.clock import monotonic_s, utc_ns
from common.config import ConfigError
from common.topics import GATE_STATE
from services.jetson.gate.config import GateConfig
from services.jetson.gate.journal import Journal
from services.jetson.gate.output import Output, open_outputs
from services.jetson.gate.pipeline import STOPPED, Decision, GatePipeline
from services.jetson.gate.publish import StateNews
from services.jetson.gate.source import Acknowledgement, listen


def run(config: GateConfig) -> bool:
    """Put permission out to the actuators until the process ends; False if not closed cleanly."""
    if os.environ.get("SPOTTER_SHADOW"):
        raise ConfigError("a gate never runs in the shadow of another one: two would drive one actuator")
    pipeline, news, journal = GatePipeline(config), StateNews(config), Journal()
    decision = STOPPED
    with ExitStack() as stack:
        outputs = open_outputs(config)
        for output in outputs:
            stack.callback(output.close)
        service = stack.enter_context(Service("gate", config))
        publish = service.publisher(GATE_STATE)
        acknowledgement = Acknowledgement(service, lambda: answer(decision))
        for inputs in listen(service, config):
            now_s = monotonic_s()
            pressed = sum(output.presses() for output in outputs) > 0
            lost = "; ".join(fault for output in outputs if (fault := output.fault(now_s)))
            inputs = inputs._replace(actuator_lost=lost, acknowledged=acknowledgement.taken() or pressed)
            decision = pipeline.process(now_s, inputs)
            send(outputs, now_s, decision, inputs.verdict.seq if inputs.verdict else 0)
            journal.note(decision)
            state = news.news(now_s, utc_ns(), decision, inputs.verdict, outputs)
            if state is not None:
                publish(state)
    return service.closed_cleanly


def send(outputs: list[Output], now_s: float, decision: Decision, verdict_seq: int) -> None:
    """To every actuator; a STOP reaches the others whatever is wrong with one of them."""
    for output in outputs:
        output.send(now_s, decision, verdict_seq)


def answer(decision: Decision) -> dict[str, object]:
    """To somebody who acknowledges: whether that counts now."""
    return {"counts": decision.cause in ("waiting", "acknowledge"), **decision._asdict()}


app = service_app("gate", GateConfig, run, __doc__)


def main() -> None:
    """The console command ``spotter-gate``."""
    app()


if __name__ == "__main__":
    main()
