"""The `spotter` command. Each group of subcommands has its own file; this one only names them."""

from __future__ import annotations

import atexit
import traceback
from typing import NoReturn

import typer

from common.cli.demo import demo
from common.cli.doctor import doctor
from common.cli.drill import drill
from common.cli.export import export
from common.cli.foxglove import foxglove
from common.cli.incident import app as incident
from common.cli.install import install
from common.cli.keys import keys
from common.cli.look import echo, health, hz, ls
from common.cli.metrics import metrics
from common.cli.plot import plot
from common.cli.record import record
from common.cli.replay import replay
from common.cli.rerun import rerun
from common.cli.router import router
from common.cli.swap import swap
from common.cli.top import top
from common.cli.up import up
from common.launch import code_of, end_process

app = typer.Typer(
    name="spotter",
    help="Perception over Zenoh for collision prevention and roadside sensing.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (
    demo,
    up,
    router,
    ls,
    echo,
    hz,
    health,
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
    drill,
):
    app.command()(command)
app.add_typer(keys, name="keys")
app.add_typer(incident, name="incident")


def main() -> NoReturn:
    """Entry point; Ctrl-C ends any command quietly, with exit code 130."""
    code = 0
    try:
        app(standalone_mode=True)
    except KeyboardInterrupt:
        code = 130
    except SystemExit as ending:
        code = code_of(ending)
    except BaseException:  # noqa: BLE001  told as Python tells it, and the process ends all the same
        traceback.print_exc()
        code = 1
    atexit._run_exitfuncs()  # what libraries want cleared up
    end_process(code)


if __name__ == "__main__":
    main()
