"""`spotter prove`: test drives in closed loop and simulated time, Spotter beside the article's rules."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spotter_tools.cli.fail import fail

if TYPE_CHECKING:
    from spotter_tools.prove.ground import Result


def prove(
    only: Annotated[str, typer.Option("--only", help="Drive the cases whose name contains this.")] = "",
    subset: Annotated[bool, typer.Option("--subset", help="A fixed part, spread over all kinds.")] = False,
    kept: Annotated[bool, typer.Option("--kept", help="Cases that pass; exits with 1 when one fails.")] = False,
    drive: Annotated[
        float, typer.Option("--drive", help="Instead: laps of the yards, for so many seconds each.")
    ] = 0.0,
    list_only: Annotated[bool, typer.Option("--list", help="Name the cases and stop.")] = False,
    jobs: Annotated[int, typer.Option(help="Processes; 0 = one a core.")] = 0,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for results.json and the pictures.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as one JSON list.")] = False,
) -> None:
    """Drive the proving ground; exits with 1 when one of the bars is not met."""
    try:
        import services.radar_pi.pipeline  # noqa: F401
        from spotter_tools.prove import bars, catalogue, ground, picture, table  # noqa: F401
        from spotter_tools.prove.kept import kept as kept_cases
        from spotter_tools.prove.yards import yard_cases
    except ImportError as error:
        fail(f"the proving ground needs the extras `jetson`, `radar-pi` and `plot`: {error}")
    everything = catalogue.subset() if subset else catalogue.all_cases()
    if kept or drive:
        everything = kept_cases() if kept else yard_cases(drive)
    cases = [case for case in everything if only in case.name]
    if not cases:
        fail(f"no case has {only!r} in its name; `spotter prove --list` names them", code=2)
    if list_only:
        print("\n".join(case.name for case in cases))
        return
    started_s = time.monotonic()
    results = ground.prove(cases, jobs or os.cpu_count() or 1, out, _progress(len(cases)))
    sys.stderr.write(f"\r{len(cases)} cases in {time.monotonic() - started_s:.0f} s{' ' * 60}\n")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "results.json").write_text(json.dumps(ground.as_json(results), indent=1))
    print(json.dumps(ground.as_json(results)) if as_json else "\n".join(table.lines(results)))
    missed = any(one.failed for one in results) if kept else not all(bar.met for bar in bars.bars(results))
    raise SystemExit(1 if missed else 0)


def _progress(count: int) -> Callable[[Result], None]:
    """Returns a function that shows the number of finished cases on the terminal."""
    done = 0

    def show(result: Result) -> None:
        nonlocal done
        done += 1
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{done}/{count} {result.name:60.60}")
            sys.stderr.flush()

    return show
