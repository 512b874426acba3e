"""The roadside lidar against the article's pipeline written plainly, in the same run and on the same frames.

    python -m benchmarks.infra_lidar.speed

Milliseconds of processor time of one thread, so that other work on the machine matters little. Both designs take turns,
a whole pass over the frames each, so that neither has warmer caches than the other and a processor whose speed drifts
is the same to both; what is to be read is the ratio, the median of those of ``ROUNDS`` rounds.
"""

from __future__ import annotations

import gc
import os
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from operator import attrgetter
from time import thread_time

import numpy as np
from sklearn.ensemble import RandomForestClassifier

from benchmarks.article.article_both import START_NS, ArticleByKernels, TimedPlain, train
from benchmarks.infra_lidar.frames import Frame, as_arrived, frames_of, own_cluster_share, revolutions
from benchmarks.infra_lidar.others import print_others
from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.classification.forest import Forest
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig
from services.infra_lidar.input.range_image import Returns
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.segmentation.background import BackgroundModel
from services.infra_lidar.segmentation.ground import Ground
from services.infra_lidar.warm_up import warm_up

FRAMES, ROUNDS = 24, 5
KEPT_BYTES = 31_000_000  # once freed, the C library keeps as much: else some runs pay for new pages in every frame


def compare(objects: int, model: RandomForestClassifier, forest: Forest) -> None:
    """(a) Both designs at the article's settings: milliseconds, ratio, agreement."""
    frames = frames_of(7, objects, FRAMES)
    plain, ours = TimedPlain(model), ArticleByKernels(forest)
    for frame in frames:  # compiles
        ours.process(frame)
    gc.freeze()
    plain_ms: dict[str, list[float]] = {}
    our_ms: dict[str, list[float]] = {}
    order = (ours, our_ms), (plain, plain_ms), (ours, our_ms)
    for _ in range(ROUNDS):
        for pipeline, spent in order:
            pipeline.begin()
            for frame in frames:
                pipeline.process(as_arrived(frame))
            for name in ("total", *pipeline.timed.stages):
                spent.setdefault(name, []).append(pipeline.timed.median("" if name == "total" else name))
    print(
        f"\n(a) article's settings, {len(frames[0].points)} points, {objects} objects, "
        f"{_agreement(frames, plain, ours)}"
    )
    for name in (*plain.timed.stages, "total"):
        _print_ratio(name, plain_ms[name], our_ms[name])


def _print_ratio(name: str, plain_ms: list[float], our_ms: list[float]) -> None:
    a, b = np.array(plain_ms), np.array(our_ms).reshape(ROUNDS, 2).mean(axis=1)  # before and after
    ratios = a / b
    print(
        f"  {name:9} plain {np.median(a):8.2f} ms   ours {np.median(b):7.3f} ms   {np.median(ratios):6.1f} x"
        f"   ({ratios.min():.1f} to {ratios.max():.1f})"
    )


def _agreement(frames: list[Frame], plain: TimedPlain, ours: ArticleByKernels) -> str:
    """How many of the plain version's clusters, classes and confirmed tracks ours has, too."""
    plain.begin()
    ours.begin()
    matched = same_class = total = 0
    twins = []
    for frame in frames:
        a, b = plain.process(frame), ours.process(frame)
        near = _nearest(a["centres"], b["centres"])
        total += len(near)
        matched += int((near[:, 1] < 0.02).sum())
        same_class += int((a["labels"] == b["labels"][near[:, 0].astype(int)])[near[:, 1] < 0.02].sum())
        theirs = np.array([t.x[:3] for t in plain.tracker.tracks if t.confirmed]).reshape(-1, 3)
        mine = ours.tracker.tracks
        twins.append(_nearest(theirs, mine.state[mine.confirmed, :3])[:, 1])
    return (
        f"{total // FRAMES} clusters; equal: clusters {matched / total:.2%}, "
        f"classes {same_class / max(matched, 1):.2%}, confirmed tracks {np.mean(np.concatenate(twins) < 0.05):.2%}"
    )


def _nearest(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(len(a), 2): index of the nearest of b, and its distance."""
    if not len(a) or not len(b):
        return np.column_stack([np.zeros(len(a)), np.full(len(a), np.inf)])
    apart = np.linalg.norm(a[:, None] - b[None], axis=2)
    return np.column_stack([apart.argmin(axis=1), apart.min(axis=1)])


def default_design(objects: int, model: RandomForestClassifier) -> None:
    """(b) Our own design, first on whole frames, then with the scene learned: in the 20 seconds after these frames."""
    frames, plain = frames_of(7, objects, FRAMES), TimedPlain(model)
    calibration, by_points, by_ranges = learned_scene(objects)
    whole, learned = InfraLidarConfig(background=BackgroundConfig(enabled=False)), InfraLidarConfig()
    ways = {
        "whole frames": Way(whole, calibration, None, attrgetter("points")),
        "scene learned": Way(learned, calibration, by_points, attrgetter("points")),
        "  from ranges": Way(learned, calibration, by_ranges, attrgetter("image")),
    }
    plain_ms, spent = [], {name: [way.median_ms(frames)] for name, way in ways.items()}
    for _ in range(ROUNDS):
        plain.begin()
        for frame in frames:
            plain.process(as_arrived(frame))
        plain_ms.append(plain.timed.median(""))
        for name, way in ways.items():
            spent[name].append(way.median_ms(frames))
    for name, way in ways.items():
        between = np.convolve(spent[name], [0.5, 0.5], "valid")  # before and after the plain version's turn
        ratios = np.array(plain_ms) / between
        own, known = way.own_clusters(frames)
        print(
            f"  {name:14} {np.median(between):7.2f} ms   {np.median(ratios):6.1f} x ({ratios.min():.1f} to "
            f"{ratios.max():.1f}); objects with a cluster of their own {own:.1%}; known {known:.0%}; "
            + " ".join(f"{stage} {np.median(ms):.2f}" for stage, ms in way.stage_ms.items())
        )


@dataclass
class Way:
    """Our pipeline with what it knows from the beginning, and the form in which it gets a frame."""

    config: InfraLidarConfig
    calibration: Calibration
    background: BackgroundModel | None
    form: Callable[[Frame], Returns]
    stage_ms: defaultdict[str, list[float]] = field(default_factory=lambda: defaultdict(list))

    def median_ms(self, frames: list[Frame]) -> float:
        """Of a frame, processor time, in a pass over all of them."""
        pipeline, spent = InfraLidarPipeline(self.config, self.calibration, self.background), []
        for k, frame in enumerate(frames):
            returns = self.form(as_arrived(frame))
            t = thread_time()
            result = pipeline.process(START_NS + k * 100_000_000, returns)
            spent.append((thread_time() - t) * 1e3)
            for stage, ms in result.stage_ms.items():
                self.stage_ms[stage].append(ms)
        return float(np.median(spent))

    def own_clusters(self, frames: list[Frame]) -> tuple[float, float]:
        """Share of the objects with a cluster of their own, and of the returns that are known; means over frames."""
        pipeline, own, known = InfraLidarPipeline(self.config, self.calibration, self.background), [], []
        for k, frame in enumerate(frames):
            returns = self.form(frame)
            result = pipeline.process(START_NS + k * 100_000_000, returns)
            of_point = result.cluster_id if returns is frame.points else result.cluster_id[frame.place]
            own.append(own_cluster_share(frame, of_point))
            known.append(result.background.sum() / result.points_in)
        return float(np.mean(own)), float(np.mean(known))


def learned_scene(objects: int) -> tuple[Calibration, BackgroundModel, BackgroundModel]:
    """What a pole knows after its first 20 seconds of that street, seen as points and as ranges."""
    of_points, of_ranges = InfraLidarPipeline(InfraLidarConfig()), InfraLidarPipeline(InfraLidarConfig())
    for k, frame in enumerate(revolutions(7, objects, FRAMES + 300)):
        if k >= FRAMES:
            of_points.process(START_NS + k * 100_000_000, frame.points)
            of_ranges.process(START_NS + k * 100_000_000, frame.image)
        models = [pipeline.scene.background.model for pipeline in (of_points, of_ranges)]
        calibration = of_points.calibration.settled_calibration
        if models[0] is not None and models[1] is not None and calibration is not None:
            return calibration, models[0], models[1]
    raise RuntimeError("nothing was learned in 30 seconds")


def scaling() -> None:
    """Linear in points, nearly flat in objects: our default design on whole frames, tracks included."""
    config = InfraLidarConfig(background=BackgroundConfig(enabled=False))

    def milliseconds(frames: list[Frame]) -> tuple[int, float, float]:
        pipeline, spent = InfraLidarPipeline(config), []
        for k in range(14):
            t = thread_time()
            result = pipeline.process(START_NS + k * 100_000_000, frames[k % len(frames)].points)
            spent.append((thread_time() - t) * 1e3 - result.stage_ms["calibrate"])
        late = spent[6:]
        return len(frames[0].points), float(np.median(late)), float(np.max(late))

    print("\nscaling with points (40 objects):")
    last = None
    for columns in (590, 1180, 2360, 4720, 9440):
        points, median_ms, worst_ms = milliseconds(frames_of(9, 40, 1, columns))
        growth = f"{median_ms / last:.2f} per doubling" if last else ""
        print(f"  {points:7d} points  {median_ms:7.2f} ms  worst {worst_ms:7.2f}  {growth}")
        last = median_ms
    print("scaling with objects (2300 columns):")
    first = None
    for objects in (10, 40, 160, 400):
        points, median_ms, _ = milliseconds(frames_of(9, objects, 1))
        first = first or median_ms
        print(f"  {objects:4d} objects  {points} points  {median_ms:7.2f} ms  {median_ms / first:.2f} x")


def memory() -> None:
    """Bytes that one sensor's pipeline keeps between frames."""
    pipeline = InfraLidarPipeline(InfraLidarConfig(background=BackgroundConfig(learn_s=0.3, min_frames=5)))
    frame = frames_of(7, 40, 1)[0]
    for k in range(14):
        pipeline.process(START_NS + k * 100_000_000, frame.points)
    model = pipeline.scene.background.model
    kept = (model.intervals, model.is_road, model.surface, model.static_map) if model else ()
    print(
        f"\nkept between frames: {pipeline.scene.ground.nbytes / 1e6:.1f} MB of polar grid and road map, "
        f"{sum(array.nbytes for array in kept) / 1e6:.1f} MB of background"
    )


def others(objects: int) -> None:
    """Other people's ground and clusters on the same frames."""
    frames, ground = frames_of(7, objects, 6), Ground(InfraLidarConfig().ground)
    print_others(frames, lambda frame: ground.remove(frame.points, frame.T_level_sensor).points)


def main() -> None:
    """Both comparisons at 40 and 160 objects, then how time and memory grow."""
    model, forest = train()
    warm_up(InfraLidarConfig(), lambda _: None)
    np.ones(KEPT_BYTES, np.uint8)
    gc.freeze()  # as the service does: what is there by now is not looked through for garbage again
    for objects in (40, 160):
        compare(objects, model, forest)
        print(f"(b) our own design, {objects} objects, its own calibration:")
        default_design(objects, model)
        others(objects)
    scaling()
    memory()


if __name__ == "__main__":
    main()
