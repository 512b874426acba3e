"""``spotter-infra-lidar adapt``: train a forest for the site, accept it if it is better, or remove it again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from common.bus.service_app import check_output, load_config, setup_logging
from common.config import ConfigError
from services.infra_lidar.classification.classes import BACKGROUND, CLASSES
from services.infra_lidar.classification.classifier import Classifier
from services.infra_lidar.classification.forest import SUFFIX, load_forest
from services.infra_lidar.command_line import require_train, say, write_forest
from services.infra_lidar.config import InfraLidarConfig

if TYPE_CHECKING:
    from services.infra_lidar.adaptation.adapt import Outcome
    from services.infra_lidar.adaptation.recorder import SiteRecord

DEFAULT_FILE = "site_forest.npz"


def adapt(
    context: typer.Context,
    seconds: Annotated[float, typer.Option("--seconds", min=1.0, help="Of the source; a recording may end before.")] = (
        900.0
    ),
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The site's forest; default: [classifier] site_model.")
    ] = None,
    undo: Annotated[bool, typer.Option("--undo", help="Remove the site's forest; the one before is used again.")] = (
        False
    ),
) -> None:
    """Train a forest for this site from its own tracks, without labels; refused unless better on held-out data."""
    setup_logging("infra_lidar")
    config = load_config(InfraLidarConfig, *context.obj)
    path = output or Path(config.classifier.site_model or DEFAULT_FILE)
    if undo:
        _remove(path)
        return
    require_train()
    check_output(path, SUFFIX)
    if path.exists() and not _of_a_site(path):
        raise ConfigError(f"{path}: is there, and was not made by `spotter-infra-lidar adapt`: choose another file")
    outcome = _learn(config, seconds)
    _refuse(outcome.objections)
    size = write_forest(outcome.forest, path)
    say(f"accepted: {path}, {size}; undo it with `spotter-infra-lidar adapt --undo -o {path.resolve()}`")
    if config.classifier.site_model != str(path):
        say(f'to use it from the next start on: [classifier] site_model = "{path.resolve()}"')


def _learn(config: InfraLidarConfig, seconds: float) -> Outcome:
    from services.infra_lidar.adaptation.adapt import divide, learn_site, record_site
    from services.infra_lidar.adaptation.site_forest import generated_examples, unseen_examples
    from services.infra_lidar.adaptation.verdict import too_few

    try:
        record = record_site(config, seconds)
    except ConfigError:  # it names the source itself
        raise
    except ValueError as error:
        raise ConfigError(f"{config.source}: {error}") from None
    say(_seen(record))
    _refuse(list(too_few(divide(record)[1])))  # before minutes are spent on growing
    generated = generated_examples(config), unseen_examples(config)
    outcome = learn_site(config, record, Classifier(config.classifier).forest, generated)
    say(*_table(outcome))
    return outcome


def _refuse(objections: list[str]) -> None:
    """End with exit code 1 where there is an objection."""
    if objections:
        say("refused, nothing is changed:", *(f"  {reason}" for reason in objections))
        raise typer.Exit(1)


def _seen(record: SiteRecord) -> str:
    length_s = (record.sampled_ns[-1] - record.sampled_ns[0]) * 1e-9
    sampled = f"{len(record.sampled_ns)} sampled revolutions"
    return f"{length_s:.0f} s: {sampled}, {len(record.x)} clusters, {len(record.tracks)} tracks"


def _table(outcome: Outcome) -> list[str]:
    """The clusters used for training, and the figures of both forests on held-out data."""
    learned, held_out = outcome.learned, outcome.held_out
    lines = [f"{'labelled':<22}{'clusters':>10}{'road users':>12}{'held out':>10}"]
    for c, name in enumerate(CLASSES):
        mine = learned.labels == c
        groups = "" if c == BACKGROUND else str(len(np.unique(learned.groups[mine])))
        lines.append(f"{name:<22}{np.sum(mine):10d}{groups:>12}{np.sum(held_out.labels == c):10d}")
    lines.append(f"{'held out':<34}{'in use':>10}{'of the site':>12}")
    before, after = outcome.before, outcome.after
    lines.append(f"{'clusters of road users called right':<34}{before.right:9.1%}{after.right:11.1%}")
    lines.append(f"{'false road users per revolution':<34}{before.false:7.2f}{after.false:11.2f}")
    for c, name in enumerate(CLASSES):
        if c != BACKGROUND:
            shown = f"generated streets, {name} called right"
            lines.append(f"{shown:<34}{before.recall[c]:8.1%}{after.recall[c]:11.1%}")
    return lines


def _remove(path: Path) -> None:
    """Undo.

    Raises:
        ConfigError: there is no such file, or it is no forest of a site.
    """
    if not path.exists():
        raise ConfigError(f"{path}: no forest of a site here: nothing to undo")
    if not _of_a_site(path):
        raise ConfigError(f"{path}: was not made by `spotter-infra-lidar adapt`: not removed")
    path.unlink()
    say(f"{path} removed: from the next start on the forest before it is used")


def _of_a_site(path: Path) -> bool:
    """Whether ``adapt`` has made this forest."""
    return "instead_of" in load_forest(path).provenance
