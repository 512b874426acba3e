"""Further subcommands of spotter-infra-lidar: train, evaluate, plot."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from common.bus.service_app import check_output, setup_logging
from common.config import ConfigError
from services.infra_lidar.classification.classifier import SHIPPED_MODEL
from services.infra_lidar.classification.forest import SUFFIX
from services.infra_lidar.command_line import require_train, say, write_forest
from services.infra_lidar.config import InfraLidarConfig

log = logging.getLogger(__name__)

TRAIN_SEED, TEST_SEED = 1000, 5000  # first seeds; training and test ranges do not overlap
Folder = Annotated[
    Path | None, typer.Argument(metavar="DIR", help="{train,test}/<class>/*.bin; without it generated scenes are used.")
]
Scenes = Annotated[int, typer.Option("--scenes", min=2, help="Generated roadside scenes; to train, twice as many.")]


def add_commands(app: typer.Typer) -> None:
    """Register the subcommands."""
    app.command("train")(train)
    app.command("evaluate")(evaluate)
    app.command("plot")(plot)


def train(
    folder: Folder = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="The model file.")] = Path("forest.npz"),
    scenes: Scenes = 80,
    bodies: Annotated[int, typer.Option("--bodies", min=0, help="Single generated bodies per class besides.")] = 3000,
    trees: Annotated[int | None, typer.Option("--trees", min=1, help="Default: 144; of a folder 48.")] = None,
    leaves: Annotated[
        int | None, typer.Option("--leaves", min=2, help="Of a tree, at the most. Default: 160; of a folder 1000.")
    ] = None,
) -> None:
    """Train a forest from labelled clusters, or from generated scenes, and store it as plain arrays."""
    setup_logging("infra_lidar")
    require_train()
    from services.infra_lidar.training.train import GENERATED, ForestSettings, train_forest, training_set

    check_output(output, SUFFIX)
    clusters, weight, provenance = training_set(folder, scenes, bodies, TRAIN_SEED)
    log.info("training on %d clusters", len(clusters))
    usual = ForestSettings() if folder else GENERATED
    settings = replace(usual, trees=trees or usual.trees, max_leaves=leaves or usual.max_leaves)
    features = "shape" if folder else "any_sensor"  # clusters in files are centred: no distance to the sensor
    forest = train_forest(clusters, features, provenance, settings, report=say, weight=weight)
    size = write_forest(forest, output)
    say(f"{output}: {settings.trees} trees, {len(forest.feature)} nodes, {size}, {forest.digest[:12]}")


def evaluate(
    folder: Folder = None,
    model: Annotated[Path, typer.Option("--model", help="Default: the model that is shipped.")] = SHIPPED_MODEL,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder for the pictures.")] = None,
    scenes: Scenes = 24,
) -> None:
    """Per-class table, confusion matrix and confidence, on groups not trained on."""
    setup_logging("infra_lidar")
    require_train()
    from services.infra_lidar.classification.features import FROM_RANGE
    from services.infra_lidar.classification.forest import load_forest
    from services.infra_lidar.training import evaluate as evaluation
    from services.infra_lidar.training.train import test_set

    forest = load_forest(model)
    test = test_set(folder, scenes, TEST_SEED)
    if folder and (ranged := sorted(set(forest.features) & set(FROM_RANGE))):
        say(f"the model needs {', '.join(ranged)}, which centred clusters do not have: the figures are too low")
    result = evaluation.evaluate_forest(forest, test)
    say(evaluation.class_table(result), "", evaluation.confusion_table(result))
    if output:
        from services.infra_lidar.training import evaluate_plots

        evaluate_plots.draw_confusion(result, output / "confusion.png")
        evaluate_plots.draw_confidence(result, output / "confidence.png")
        say(f"pictures in {output}")


def plot(
    context: typer.Context,
    output: Annotated[
        Path, typer.Argument(metavar="OUTPUT", help="A .png: the last frame; .mp4 or .gif: all; a folder: a PNG each.")
    ],
    frames: Annotated[int, typer.Option("--frames", min=1, help="Stop after this many.")] = 100,
    reach: Annotated[float, typer.Option("--reach", min=1.0, help="Metres shown to each side.")] = 60.0,
) -> None:
    """Top view of the source: ground, clusters by class, tracks and their ways. `--plot OUTPUT` is the same."""
    setup_logging("infra_lidar")
    from common.bus.service_app import errors_in_one_line, load_config
    from services.infra_lidar.plot import plot_source

    with errors_in_one_line():
        config = load_config(InfraLidarConfig, *context.obj)
        count = plot_source(config, output, frames, reach)
        if count == 0:
            raise ConfigError(f"source {config.source}: not one frame came; {output} is not drawn")
        say(f"{output}: {'the last of ' if output.suffix == '.png' else ''}{count} frames")
