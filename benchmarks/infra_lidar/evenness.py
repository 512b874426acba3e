"""How even a frame's time is over a minute of traffic: 99th percentile against the median.

    python -m benchmarks.infra_lidar.evenness

Processor time of one thread. Between two frames the next one is generated, which evicts the caches as the other work of
a service does. The first frames, in which buffers grow and the scene is learned, are left out.
"""

from __future__ import annotations

import gc
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from operator import attrgetter
from time import thread_time

import numpy as np

from benchmarks.article.article_both import START_NS, ArticleByKernels, train
from benchmarks.infra_lidar.frames import Frame, as_arrived, revolutions
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig
from services.infra_lidar.input.range_image import Returns
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.warm_up import warm_up

FRAMES, FIRST = 630, 230


def _design(background: BackgroundConfig, form: Callable[[Frame], Returns]) -> Callable[[int, Frame], object]:
    pipeline = InfraLidarPipeline(InfraLidarConfig(background=background))
    return lambda k, frame: pipeline.process(START_NS + k * 100_000_000, form(frame))


def main() -> None:
    """The command above."""
    _, forest = train()
    warm_up(InfraLidarConfig(), lambda _: None)
    gc.freeze()  # as the service does: what is there by now is not looked through for garbage again
    article = ArticleByKernels(forest)
    for objects in (40, 160):
        ways: dict[str, Callable[[int, Frame], object]] = {
            "article's settings": lambda _, frame: article.process(frame),
            "own design, whole frames": _design(BackgroundConfig(enabled=False), attrgetter("points")),
            "own design, scene learned": _design(BackgroundConfig(), attrgetter("points")),
            "  from ranges": _design(BackgroundConfig(), attrgetter("image")),
        }
        article.begin()
        spent: dict[str, list[float]] = {name: [] for name in ways}
        for k, frame in enumerate(revolutions(7, objects, FRAMES)):
            for name, process in ways.items():
                arrived = as_arrived(frame)
                begun = thread_time()
                process(k, arrived)
                spent[name].append((thread_time() - begun) * 1e3)
        print(f"\n{objects} objects, {FRAMES - FIRST} frames")
        for name, ms in spent.items():
            late = np.array(ms[FIRST:])
            median, p99 = np.percentile(late, [50, 99])
            print(
                f"  {name:26} median {median:6.2f} ms   p99 {p99:6.2f}, {p99 / median:.2f} x   worst {late.max():6.2f}"
            )


if __name__ == "__main__":
    main()
