"""Runs all cases on all cores: each with Spotter and with the article's rules, compared with the physical limit."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

from spotter_tools.prove.case import Case, Outcome
from spotter_tools.prove.yardstick import Yardstick

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")  # one process per core already


@dataclass(frozen=True)
class Result:
    """One case, and its outcome with each decider."""

    name: str
    family: str
    preset: str
    dangerous: bool
    out: str
    ego: bool
    tags: tuple[str, ...]
    yardstick: Yardstick
    spotter: Outcome
    article: Outcome

    @property
    def failed(self) -> bool:
        """Spotter had an avoidable collision, or braked or said IMMINENT without need."""
        if self.dangerous:
            return self.yardstick.avoidable and self.spotter.collided
        return self.spotter.collided or self.spotter.false_brakes > 0 or self.spotter.imminent_s > 0.0


def prove_case(case: Case, pictures: Path | None = None) -> Result:
    """Run one case with both deciders; a failed one is drawn into the folder ``pictures``."""
    from spotter_tools.prove.judge import judge
    from spotter_tools.prove.loop import drive
    from spotter_tools.prove.yardstick import measure

    yardstick = measure(case)
    ours = drive(case, "spotter")
    result = Result(
        case.name, case.family, case.preset, case.dangerous, case.out, case.ego, case.tags, yardstick,
        spotter=judge(ours, yardstick), article=judge(drive(case, "article"), yardstick),
    )  # fmt: skip
    if result.failed and pictures is not None:
        from spotter_tools.prove.picture import draw

        draw(ours, result, pictures)
    return result


def prove(
    cases: Iterable[Case], jobs: int, pictures: Path | None = None, on_result: Callable[[Result], None] = lambda _: None
) -> list[Result]:
    """Results in the order of the cases; ``on_result`` is called for each result."""
    cases = list(cases)
    if jobs <= 1:
        results = []
        for case in cases:
            results.append(prove_case(case, pictures))
            on_result(results[-1])
        return results
    found: dict[int, Result] = {}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_end_with_parent) as pool:
        waiting = {pool.submit(prove_case, case, pictures): i for i, case in enumerate(cases)}
        for done in as_completed(waiting):
            found[waiting[done]] = done.result()
            on_result(done.result())
    return [found[i] for i in range(len(cases))]


def _end_with_parent() -> None:
    """In a worker: end when the parent was killed. The queue does not show it, because the worker holds both ends."""
    parent = multiprocessing.parent_process()
    if parent is not None:

        def watch() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=watch, name="parent", daemon=True).start()


def as_json(results: list[Result]) -> list[dict[str, object]]:
    """For a file: every field of every result."""
    return [{**asdict(result), "failed": result.failed} for result in results]
