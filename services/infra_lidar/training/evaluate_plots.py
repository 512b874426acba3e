"""The pictures of an evaluation: confusion matrix and confidence. The only place here that needs matplotlib."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.training.evaluate import Evaluation


def draw_confusion(result: Evaluation, path: Path) -> None:
    """Shares of each true class, with the counts written in."""
    figure = Figure(figsize=(6, 5), layout="constrained")
    axes = figure.add_subplot()
    share = result.confusion / np.maximum(result.confusion.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for (row, column), count in np.ndenumerate(result.confusion):
        colour = "white" if share[row, column] > 0.6 else "black"
        axes.text(column, row, f"{count}\n{share[row, column]:.1%}", ha="center", va="center", color=colour, fontsize=8)
    names = [name.replace("_", "\n") for name in CLASSES]
    axes.set_xticks(range(len(CLASSES)), names)
    axes.set_yticks(range(len(CLASSES)), names)
    axes.set(xlabel="called", ylabel="true", title=f"macro F1 {result.macro_f1:.3f}")
    _save(figure, path)


def draw_confidence(result: Evaluation, path: Path) -> None:
    """Confidence where right and where wrong, and how often a confidence is right."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    bins = np.linspace(0, 1, 26)
    left.hist(result.confidence[result.correct], bins, density=True, alpha=0.6, label="right")
    left.hist(result.confidence[~result.correct], bins, density=True, alpha=0.6, label="wrong")
    left.set(xlabel="confidence", ylabel="density", title="confidence")
    left.legend()
    index = np.minimum((result.confidence * 10).astype(int), 9)
    used = np.unique(index)
    said = [result.confidence[index == b].mean() for b in used]
    right.plot([0, 1], [0, 1], color="grey", linewidth=1)
    right.plot(said, [result.correct[index == b].mean() for b in used], "o-")
    right.set(xlabel="confidence", ylabel="share right", title=f"calibration error {result.calibration_error():.3f}")
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=120)
