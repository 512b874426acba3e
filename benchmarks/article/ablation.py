"""Macro F1 over the article's feature sets and Spotter's own, one forest each, on streets not trained on.

    python -m benchmarks.article.ablation [DIR] [-o PICTURE.png]

DIR: labelled clusters in files, as `spotter-infra-lidar train DIR` takes them; without it those of generated streets.
Needs the ``train`` extra. Forests are the article's: 100 trees, no limit on the leaves, calibrated as the shipped one.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from sklearn.ensemble import RandomForestClassifier

from benchmarks.article.costly_features import ALL_SETS, compute_features
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.classification.features import FROM_RANGE
from services.infra_lidar.classification.forest import calibrated
from services.infra_lidar.training.clusters import LabelledClusters
from services.infra_lidar.training.evaluate import Evaluation, judge
from services.infra_lidar.training.train import calibrate, out_of_group_shares, test_set, training_set

TRAINING_SCENES, TEST_SCENES = 24, 24
TRAINING_SEED, TEST_SEED = 1000, 5000
# Macro F1 on the test set of the article's private data, four classes (its ablation table).
ARTICLE_F1 = {"9": 0.731, "11": 0.777, "13": 0.779, "18": 0.799, "19": 0.800, "23": 0.815, "35": 0.822}


def article_forest() -> RandomForestClassifier:
    """The article's classifier, not fitted."""
    return RandomForestClassifier(
        100, max_depth=20, min_samples_leaf=5, class_weight="balanced", random_state=42, n_jobs=1
    )


def ablation(
    train: LabelledClusters, test: LabelledClusters, sets: dict[str, tuple[str, ...]]
) -> Iterator[tuple[str, Evaluation]]:
    """The name of each of ``sets`` and how well a forest with these features tells the clusters of ``test``."""
    for name, features in sets.items():
        x = _table(train, features)
        fit = partial(_fit, x, train.labels)
        curve_x, curve_y = calibrate(out_of_group_shares(fit, x, train.groups), train.labels)
        model = fit(np.arange(len(x)))
        shares = np.zeros((len(test), len(CLASSES)))
        shares[:, model.classes_] = model.predict_proba(_table(test, features))
        yield name, judge(calibrated(shares, curve_x, curve_y), test.labels)


def _fit(x: np.ndarray, labels: np.ndarray, rows: np.ndarray) -> RandomForestClassifier:
    return article_forest().fit(x[rows], labels[rows])


def _table(clusters: LabelledClusters, features: tuple[str, ...]) -> np.ndarray:
    return compute_features(clusters.points, clusters.offsets, clusters.ground_z_m, features)


def heading() -> str:
    """The names of the columns of ``row``."""
    names = "".join(f"{name[:9]:>10}" for name in CLASSES)
    return f"{'set':<10}{'N':>4}{'macro F1':>10}{names}{'gap':>8}{'article':>12}"


def row(name: str, result: Evaluation) -> str:
    """A feature set: its name, how many features, F1 over all and per class, confidence gap, and the article's F1."""
    article = f"{ARTICLE_F1[name]:.3f}" if name in ARTICLE_F1 else "-"
    per_class = "".join(
        f"{v:10.3f}" if there else f"{'-':>10}" for v, there in zip(result.f1, result.present, strict=True)
    )
    gap = f"{confidence_gap(result):8.3f}"
    return f"{name:<10}{len(ALL_SETS[name]):4d}{result.macro_f1:10.3f}{per_class}{gap}{article:>12}"


def confidence_gap(result: Evaluation) -> float:
    """Mean confidence where right less that where wrong, the article's measure of a set; NaN without both."""
    if result.correct.all() or not result.correct.any():
        return float("nan")
    return float(result.confidence[result.correct].mean() - result.confidence[~result.correct].mean())


def draw(rows: list[tuple[str, Evaluation]], path: Path) -> None:
    """Macro F1 over the feature sets, beside the article's figures on its own data."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    names = [name for name, _ in rows]
    axes.plot(range(len(rows)), [result.macro_f1 for _, result in rows], "o-", label="these clusters, 5 classes")
    known = [place for place, name in enumerate(names) if name in ARTICLE_F1]
    article = [ARTICLE_F1[names[place]] for place in known]
    axes.plot(known, article, "s--", label="article, private data, 4 classes")
    axes.set_xticks(range(len(rows)), names)
    axes.set(xlabel="feature set", ylabel="macro F1 on unseen groups")
    axes.grid(alpha=0.3)
    axes.legend()
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=120)


def main() -> None:
    """The command above."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.article.ablation")
    parser.add_argument("folder", nargs="?", type=Path, metavar="DIR")
    parser.add_argument("-o", "--output", type=Path, metavar="PICTURE.png")
    options = parser.parse_args()
    train, _, _ = training_set(options.folder, TRAINING_SCENES, 0, TRAINING_SEED)
    test = test_set(options.folder, TEST_SCENES, TEST_SEED)
    # Clusters in files are centred: they have no distance to the sensor.
    sets = {name: f for name, f in ALL_SETS.items() if not (options.folder and set(f) & set(FROM_RANGE))}
    rows = []
    print(heading())
    for name, result in ablation(train, test, sets):
        rows.append((name, result))
        print(row(name, result), flush=True)
    if options.output:
        draw(rows, options.output)


if __name__ == "__main__":
    main()
