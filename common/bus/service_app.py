"""The command line that every service shares: ``--config FILE``, ``--set section.key=value``, ``--source URL``.

    app = service_app("radar", RadarConfig, run, __doc__)

gives ``spotter-radar``; further subcommands are added to ``app``. Exit code 0 after Ctrl-C or SIGTERM, 1 after a
failure, 2 when the configuration is wrong.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Annotated, NoReturn, TypeVar

import msgspec
import typer

from common.bus.session import init_zenoh_log
from common.bus.watchdog import say_stopping
from common.config import ConfigError, ServiceConfig, load

STOP_AGAIN_S = 0.05  # after a signal that was lost in a callback

C = TypeVar("C", bound=ServiceConfig)

ConfigOption = Annotated[Path | None, typer.Option("--config", help="TOML file; without it the shipped defaults.")]
SetOption = Annotated[list[str] | None, typer.Option("--set", help="section.key=value; may be given several times.")]
SourceOption = Annotated[str | None, typer.Option("--source", help="Where the data comes from, e.g. sim:crossing.")]


def service_app(name: str, config_type: type[C], run: Callable[[C], object], doc: str | None) -> typer.Typer:
    """The command line of one service. ``run(config)`` works until it is interrupted."""
    app = typer.Typer(
        name=f"spotter-{name.replace('_', '-')}",
        help=(doc or "").strip(),
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )

    @app.callback(invoke_without_command=True, help=app.info.help)
    def start(
        context: typer.Context,
        config: ConfigOption = None,
        overrides: SetOption = None,
        source: SourceOption = None,
        show_config: Annotated[
            bool, typer.Option("--show-config", help="Print the effective configuration and stop.")
        ] = False,
    ) -> None:
        """Run the service, or the subcommand that is named, with the same options."""
        context.obj = (config, overrides, source)
        if context.invoked_subcommand is not None:
            return
        effective = load_config(config_type, config, overrides, source)
        if show_config:
            sys.stdout.write(msgspec.json.format(msgspec.json.encode(effective), indent=2).decode() + "\n")
            return
        setup_logging(name)
        init_zenoh_log("error")
        run_until_stopped(lambda: run(effective))

    return app


def load_config(config_type: type[C], path: Path | None, overrides: list[str] | None, source: str | None) -> C:
    """Load the configuration; on an error print one line and exit with code 2."""
    settings = list(overrides or [])
    if source is not None:
        settings.append(f'source="{source}"')
    try:
        return load(config_type, path, settings)
    except ConfigError as error:
        sys.stderr.write(f"spotter: {error}\n")
        raise SystemExit(2) from None


@contextmanager
def errors_in_one_line() -> Iterator[None]:
    """Prints ConfigError or OSError as one line and exits with code 2 or 1. For the subcommands of a service."""
    try:
        yield
    except ConfigError as error:
        sys.stderr.write(f"spotter: {error}\n")
        raise SystemExit(2) from None
    except OSError as error:
        sys.stderr.write(f"spotter: {error.filename or ''}: {error.strerror or error}\n")
        raise SystemExit(1) from None


def check_output(path: Path, *endings: str) -> None:
    """Check that the output file can be written before the work starts.

    Raises:
        ConfigError: there is no such folder, or the name has none of these endings (none given: any is allowed).
    """
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: no folder {path.parent}")
    if endings and path.suffix not in endings:
        raise ConfigError(f"{path}: the name has to end in {' or '.join(endings)}")


def flag_as_command(arguments: list[str], command: str) -> list[str]:
    """``--plot FILE`` among the options becomes the subcommand ``plot FILE`` behind them (``command`` is "plot").

    Options that every service has stay in front of the subcommand; all others are passed to it.
    """
    if f"--{command}" not in arguments:
        return arguments
    shared: list[str] = []
    own: list[str] = []
    values = iter(arguments)
    for word in values:
        if word.split("=")[0] in ("--config", "--set", "--source"):
            shared += [word, *islice(values, "=" not in word)]
        elif word != f"--{command}":
            own.append(word)
    return [*shared, command, *own]


def run_app(app: typer.Typer, *flags: str) -> None:
    """The console command: ``--FLAG FILE`` becomes the subcommand; errors are printed in one line."""
    arguments = sys.argv[1:]
    for flag in flags:
        arguments = flag_as_command(arguments, flag)
    with errors_in_one_line():
        app(args=arguments)


def run_until_stopped(run: Callable[[], object]) -> NoReturn:
    """Run with SIGTERM equal to Ctrl-C, then end the process: exit code 0, 1 after a failure, 2 for a wrong config.

    ``run`` closes its resources by ``with`` before that.
    """
    stopped: list[int] = []

    def stop(signum: int, _: object) -> None:
        say_stopping()
        stopped.append(signum)
        raise KeyboardInterrupt

    def swallowed(lost: sys.UnraisableHookArgs) -> None:
        """What a callback from C raises is lost there (Numba compiles so): stop again as soon as it has returned."""
        if stopped and lost.exc_type is KeyboardInterrupt:
            signal.setitimer(signal.ITIMER_REAL, STOP_AGAIN_S)
        else:
            sys.__unraisablehook__(lost)

    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(signum, stop)
    sys.unraisablehook = swallowed
    code = 0
    try:
        run()
    except KeyboardInterrupt:
        code = 0
    except ConfigError as error:
        sys.stderr.write(f"spotter: {error}\n")
        code = 2
    except SystemExit as ending:
        code = code_of(ending)
    except BaseException:
        # A signal that arrives inside compiled code comes out of it as a SystemError with the interrupt as its cause.
        if not stopped:
            logging.getLogger("service").critical("unexpected failure; the process ends", exc_info=True)
            code = 1
    end_process(code)


def code_of(ending: SystemExit) -> int:
    """The exit code by Python's rules; a text is printed and gives 1."""
    if isinstance(ending.code, int):
        return ending.code
    if ending.code is not None:
        sys.stderr.write(f"{ending.code}\n")
    return 0 if ending.code is None else 1


def end_process(code: int) -> NoReturn:
    """End at once, by ``os._exit``.

    A Zenoh thread that is stuck in the network would otherwise keep the process and its liveliness token alive. A Zenoh
    thread that delivers a message while Python shuts down would abort the process ("exception not rethrown").
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:  # the reader has closed the pipe
            pass
        except (OSError, ValueError):  # the disk is full, or it is closed: something was not written
            code = code or 1
    os._exit(code)


def setup_logging(name: str) -> None:
    """Log to stderr, one line an event, level from SPOTTER_LOG (default info)."""
    logging.basicConfig(
        stream=sys.stderr,
        level=os.environ.get("SPOTTER_LOG", "info").upper(),
        format=f"%(asctime)s %(levelname)-7s {name}/%(name)s: %(message)s",
        datefmt="%H:%M:%S",
    )
