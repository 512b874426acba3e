"""The camera service: time per stage, distance against labels, how soon a lost capture is noticed and healed."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import msgspec
import numpy as np

from benchmarks.waiting import wait_for
from common.bus.status import Report
from common.clock import utc_ns
from services.jetson.camera.config import CameraConfig, CaptureConfig, DetectorConfig, MountConfig
from services.jetson.camera.frames import NewestFrames
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.source import fitted, open_source
from services.jetson.camera.training.evaluate import Error, compare, kitti_pictures, label_boxes, lens_of
from spotter_sim import camera as simulated

DATA = Path(os.environ.get("SPOTTER_DATA", Path(__file__).parents[3] / "shared" / "data"))
REAL_NETWORK = DATA / "camera" / "yolov8n_int8.onnx"
KITTI_CAMERA_M = 1.65  # above the road, from the data set's own description
KITTI_HEIGHTS_M = {"car": 1.53, "person": 1.75, "truck": 2.8, "bicycle": 1.05, "bus": 3.0}
LABEL_NOISE_PX = 1.5
ROUNDS = 9  # the same picture: a tenth would be called frozen
CHILD = """
import os, pathlib, sys, time
book = pathlib.Path(sys.argv[1]); first = not book.exists(); book.open("a").write(f"{os.getpid()}\\n")
picture = bytes(int(sys.argv[3]) * int(sys.argv[4]) * 3)
for number in range(100000):
    if first and number == 30 and sys.argv[2] == "hang":
        sys.stdout.buffer.write(picture[:1000]); sys.stdout.buffer.flush(); time.sleep(1000)
    sys.stdout.buffer.write(picture); sys.stdout.buffer.flush(); time.sleep(1 / 30)
"""


def main() -> None:
    """Print milliseconds per stage, live results a second, distance errors against labels, and loss of the capture."""
    print("\n## Camera: time per stage, ms (median, one network thread)")
    stage_table()
    print("\n## Camera: a live camera of 30 pictures a second through capture thread and pipeline, 4 s")
    live_table()
    print("\n## Camera: distance against KITTI's labels, relative error")
    distance_table()
    print("\n## Camera: distance from the boxes of KITTI's labels themselves, camera height known")
    label_table()
    print("\n## Camera: a capture child that is lost (30 pictures a second, limit 0.5 s)")
    loss_table()


def networks() -> dict[str, str]:
    """Name -> model file ("" = the one that comes with the service); the real one where the recordings are."""
    real = {"yolov8n int8": str(REAL_NETWORK)} if REAL_NETWORK.exists() else {}
    return {"demo network": "", **real}


def live_table() -> None:
    """Results a second, pictures skipped, and milliseconds from picture to result."""
    print("| network | results/s | pictures skipped | picture to result, ms: p50 | p99 |")
    print("|---|---|---|---|---|")
    for name, model in networks().items():
        capture = msgspec.structs.replace(CaptureConfig(), rate_hz=30.0)
        network = DetectorConfig(model=model, threads=1)
        config = CameraConfig(source="sim:crossing", detector=network, capture=capture)
        pipeline, report = CameraPipeline(fitted(config)), Report("benchmark")
        source, lossless = open_source(config, report)
        latency_ms: list[float] = []
        with NewestFrames(source, report, lossless) as frames:
            until_s = time.monotonic() + 4.0
            for frame in frames:
                pipeline.process(frame.stamp_ns, frame.image)
                latency_ms.append((utc_ns() - frame.stamp_ns) / 1e6)
                if time.monotonic() > until_s:
                    break
        skipped, (p50, p99) = report.snapshot().dropped, np.quantile(latency_ms, [0.5, 0.99])
        print(f"| {name} | {len(latency_ms) / 4:.1f} | {skipped} | {p50:.0f} | {p99:.0f} |")


def stage_table() -> None:
    """Median milliseconds of each stage, by network and picture."""
    stages = ("health", "preprocess", "inference", "postprocess", "distance")
    print(f"| network, picture | {' | '.join(stages)} | total | pictures/s | pre+post / inference |")
    print("|---" * (len(stages) + 4) + "|")
    for name, model in networks().items():
        for title, image in stage_pictures():
            config = CameraConfig(detector=DetectorConfig(model=model, threads=1))
            pipeline = CameraPipeline(fitted(config))
            runs = [pipeline.process(i * 10**8, image).stage_ms for i in range(ROUNDS)]
            ms = {stage: float(np.median([run[stage] for run in runs])) for stage in stages}
            total, share = sum(ms.values()), (ms["preprocess"] + ms["postprocess"]) / ms["inference"]
            columns = " | ".join(f"{ms[stage]:.2f}" for stage in stages)
            print(f"| {name}, {title} | {columns} | {total:.1f} | {1e3 / total:.0f} | {share:.1%} |")


def stage_pictures() -> Iterator[tuple[str, np.ndarray]]:
    """(title, BGR picture) of the simulated world and of real photographs."""
    yield "simulated 640 x 480", simulated.image("crossing", 5.0)
    for name in ("camera/bus.jpg", "camera/kitti_tracking_0001/000010.png"):
        image = cv2.imread(str(DATA / name)) if (DATA / name).exists() else None
        if image is not None:
            yield f"{Path(name).name} {image.shape[1]} x {image.shape[0]}", image


def distance_table() -> None:
    """Relative errors of plain f·H/h and of ours on the same boxes of a real network, whole and cut off; how often the
    near end is not beyond the object's middle.
    """
    if not REAL_NETWORK.exists():
        print("(the recordings are not here; set SPOTTER_DATA)")
        return
    print("| boxes | objects | plain f·H/h: median, p90, worst | place unknown | near end | height known | near end |")
    print("|---|---|---|---|---|---|---|")
    unknown, known = kitti_errors(0.0), kitti_errors(KITTI_CAMERA_M)
    for name, cut in (("all", None), ("whole", False), ("cut off", True)):
        chosen = [[e for e in errors if cut in (None, e.truncated)] for errors in (unknown, known)]
        plain = summary([e.plain for e in chosen[0]])
        ours = [f"{summary([e.ours for e in errors])} | {covered(errors)}" for errors in chosen]
        print(f"| {name} | {len(chosen[0])} | {plain} | {ours[0]} | {ours[1]} |")


def covered(errors: list[Error]) -> str:
    """In how many of them the near end is no farther than the object's middle."""
    return f"{sum(e.nearest_m <= e.label.depth_m for e in errors)} of {len(errors)}"


def label_table() -> None:
    """The same geometry on thousands of boxes without a network's errors: sides placed within 1.5 px."""
    rows: dict[tuple[str, str], list[tuple[float, bool, bool]]] = {}
    for label, found, nearest_m in label_boxes(DATA, KITTI_CAMERA_M, LABEL_NOISE_PX):
        error = abs(found.distance_m / label.depth_m - 1.0)
        row = (error, found.near_m <= label.depth_m, found.near_m <= nearest_m)
        for kind in (label.kind, "both"):
            for part in ("cut off" if found.truncated else "whole", "all"):
                rows.setdefault((kind, part), []).append(row)
    print(
        "| class | boxes | objects | median, p90, worst | near end covers the middle | and the nearest part in view |"
    )
    print("|---|---|---|---|---|---|")
    for (kind, part), found_rows in sorted(rows.items()):
        errors, middle, part_in_view = zip(*found_rows, strict=True)
        shares = f"{np.mean(middle):.1%} | {np.mean(part_in_view):.1%}"
        print(f"| {kind} | {part} | {len(errors)} | {summary(list(errors))} | {shares} |")


def kitti_errors(camera_m: float) -> list[Error]:
    """Every matched object of the labelled pictures, with the real network."""
    detector = DetectorConfig(model=str(REAL_NETWORK), confidence=0.3)
    errors = []
    for picture in kitti_pictures(DATA):
        image = cv2.imread(str(picture.path))
        lens = lens_of(picture.projection, image.shape[1], image.shape[0])
        config = CameraConfig(source="file:", detector=detector, lens=lens, mount=MountConfig(height_m=camera_m))
        seen = CameraPipeline(config).process(0, image)
        errors += compare(seen.detections, picture.labels, lens, KITTI_HEIGHTS_M)
    return errors


def summary(values: list[float]) -> str:
    """Median, 90 % quantile and worst of relative errors."""
    return f"{np.median(values):.1%}, {np.quantile(values, 0.9):.0%}, {max(values):.0%}" if values else "-"


def loss_table() -> None:
    """Seconds until a lost capture child is noticed, and until pictures come again."""
    print("| what happens to the child | noticed after, s | pictures again after, s |")
    print("|---|---|---|")
    for name, blow in (("killed", signal.SIGKILL), ("frozen (SIGSTOP)", signal.SIGSTOP), ("hangs in a picture", None)):
        noticed_s, healed_s = lose_child(blow)
        print(f"| {name} | {noticed_s:.2f} | {healed_s:.2f} |")


def lose_child(blow: signal.Signals | None) -> tuple[float, float]:
    """Seconds from the last picture of the old child until health says so, and until the next picture."""
    with tempfile.TemporaryDirectory() as place:
        return _lose_child(blow, Path(place) / "book", Path(place) / "child.py")


def _lose_child(blow: signal.Signals | None, book: Path, script: Path) -> tuple[float, float]:
    script.write_text(CHILD)
    child = (sys.executable, str(script), str(book), "none" if blow else "hang", "{width}", "{height}")
    capture = msgspec.structs.replace(CaptureConfig(), csi_command=child)
    report = Report("benchmark")
    arrivals_s: list[float] = []
    with reading(CameraConfig(source="csi:0", capture=capture), report, arrivals_s):
        wait_for(lambda: len(arrivals_s) >= 20)
        if blow:
            os.kill(int(book.read_text().split()[0]), blow)
        wait_for(lambda: report.snapshot().state == "disconnected")
        noticed_s, count = time.monotonic(), len(arrivals_s)
        wait_for(lambda: len(arrivals_s) > count)
    return noticed_s - arrivals_s[count - 1], arrivals_s[count] - arrivals_s[count - 1]


@contextmanager
def reading(config: CameraConfig, report: Report, arrivals_s: list[float]) -> Iterator[None]:
    """Reads the source in a thread of its own; ``arrivals_s`` grows by the moment (s) of each picture."""
    source, lossless = open_source(config, report)

    def read() -> None:
        for _ in frames:
            arrivals_s.append(time.monotonic())
            report.state("online")

    frames = NewestFrames(source, report, lossless)
    with frames:
        reader = threading.Thread(target=read)
        reader.start()
        yield
    reader.join()


if __name__ == "__main__":
    main()
