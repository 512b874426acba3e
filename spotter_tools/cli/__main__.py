"""The `spotter` command. Each group of subcommands has its own file; this one only names them."""

from __future__ import annotations

import atexit
import importlib.metadata
import traceback
from typing import Annotated, NoReturn

import typer

from common.bus.service_app import code_of, end_process
from spotter_tools.cli.acknowledge import acknowledge
from spotter_tools.cli.bus_commands import health, info, ls
from spotter_tools.cli.cpm import cpm
from spotter_tools.cli.demo import demo
from spotter_tools.cli.doctor import doctor
from spotter_tools.cli.drill import drill
from spotter_tools.cli.export import export
from spotter_tools.cli.foxglove import foxglove
from spotter_tools.cli.gate import app as gate
from spotter_tools.cli.incident import app as incident
from spotter_tools.cli.install import install
from spotter_tools.cli.keys import keys
from spotter_tools.cli.metrics import metrics
from spotter_tools.cli.plot import plot
from spotter_tools.cli.prove import prove
from spotter_tools.cli.record import record
from spotter_tools.cli.replay import replay
from spotter_tools.cli.rerun import rerun
from spotter_tools.cli.ros2 import ros2
from spotter_tools.cli.router import router
from spotter_tools.cli.setup import setup
from spotter_tools.cli.stream_commands import echo, hz
from spotter_tools.cli.swap import swap
from spotter_tools.cli.top import top
from spotter_tools.cli.up import up


def show_version(wanted: bool) -> None:
    """The distribution's version, which is the version of the wire format."""
    if wanted:
        print(f"spotter {importlib.metadata.version('spotter')}")
        raise typer.Exit


app = typer.Typer(
    name="spotter",
    help="Perception over Zenoh for collision prevention and roadside sensing.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def about(
    version: Annotated[bool, typer.Option("--version", is_eager=True, callback=show_version, help="Print it.")] = False,
) -> None:
    """Perception over Zenoh for collision prevention and roadside sensing."""


for command in (
    demo,
    setup,
    up,
    router,
    ls,
    info,
    echo,
    hz,
    health,
    acknowledge,
    record,
    replay,
    doctor,
    install,
    swap,
    top,
    plot,
    export,
    metrics,
    foxglove,
    rerun,
    ros2,
    cpm,
    drill,
    prove,
):
    app.command()(command)
app.add_typer(keys, name="keys")
app.add_typer(incident, name="incident")
app.add_typer(gate, name="gate")


def main() -> NoReturn:
    """Entry point; Ctrl-C ends any command quietly, with exit code 130."""
    code = 0
    try:
        app(standalone_mode=True)
    except KeyboardInterrupt:
        code = 130
    except SystemExit as ending:
        code = code_of(ending)
    except BaseException:  # noqa: BLE001  printed as Python prints it, then the process ends
        traceback.print_exc()
        code = 1
    atexit._run_exitfuncs()  # what libraries want cleared up
    end_process(code)


if __name__ == "__main__":
    main()
