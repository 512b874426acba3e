"""Makes a site's forest from a recording: record, label, train, and compare on the last part of the recording."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from common.bus.status import Report
from common.recording.elapsed import Elapsed
from services.infra_lidar.adaptation.awaited import awaited
from services.infra_lidar.adaptation.labels import SiteLabels, label_site
from services.infra_lidar.adaptation.recorder import SiteRecord, SiteRecorder
from services.infra_lidar.adaptation.site_forest import (
    FEATURES,
    Examples,
    grow,
    join,
    site_examples,
)
from services.infra_lidar.adaptation.verdict import Figures, HeldOut, called, judge, objections
from services.infra_lidar.classification.classes import BACKGROUND
from services.infra_lidar.classification.forest import Forest
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.source import open_source, surveyed_pose
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.warm_up import warm_up

LEARN_SHARE = 0.75  # of the recording; the rest is held out for the comparison


class Outcome(NamedTuple):
    """The site's forest, the figures of the forest in use and of the new one on held-out data, and objections to it."""

    forest: Forest
    learned: SiteLabels
    held_out: HeldOut
    before: Figures
    after: Figures
    objections: list[str]


def record_site(config: InfraLidarConfig, seconds: float) -> SiteRecord:
    """Run the pipeline over the source for ``seconds``, or until the source ends or no frame comes for a while.

    Background subtraction is off, so that clutter stays in the clusters. Clock steps are removed from the stamps.

    Raises:
        ConfigError: the source cannot be opened.
        ValueError: no frame came, or no cluster was seen.
    """
    whole = msgspec.structs.replace(config.background, enabled=False)
    config = msgspec.structs.replace(config, T_map_sensor=surveyed_pose(config), background=whole)
    report, elapsed = Report("adapt"), Elapsed()
    frames = open_source(config, report)  # before a minute is spent on compiling: it may not be there
    pipeline = InfraLidarPipeline(config)
    recorder = SiteRecorder(FEATURES, config.ground.range_max_m)
    warm_up(config, lambda text: None)  # so that compilation does not count as recording time
    first_ns: int | None = None
    for stamp_ns, frame in awaited(frames, report):
        first_ns = stamp_ns if first_ns is None else first_ns
        into_ns = elapsed.at(stamp_ns)
        if into_ns * 1e-9 > seconds:
            break
        recorder.add(pipeline.process(first_ns + into_ns, frame.returns, frame.quality), pipeline.tracker.matches)
    return recorder.record()


def split(record: SiteRecord, labels: SiteLabels) -> tuple[SiteLabels, SiteLabels, int]:
    """The labels for training, the held-out labels, and the number of held-out revolutions.

    The last part of the recording is held out. A road user that was seen before is used for training only.
    """
    first, last = int(record.sampled_ns[0]), int(record.sampled_ns[-1])
    begin_ns = first + LEARN_SHARE * (last - first)
    late = record.stamp_ns[labels.rows] >= begin_ns
    is_user = labels.labels != BACKGROUND
    known = np.isin(labels.groups, labels.groups[~late & is_user])
    parts = (SiteLabels(*(column[rows] for column in labels)) for rows in (~late, late & ~known))
    return *parts, int(np.sum(record.sampled_ns >= begin_ns))  # type: ignore[return-value]


def divide(record: SiteRecord) -> tuple[SiteLabels, HeldOut]:
    """Label a recording; returns the labels for training and the held-out clusters."""
    learned, late, revolutions = split(record, label_site(record))
    return learned, HeldOut(record.x[late.rows], late.labels, late.groups, revolutions)


def learn_site(
    config: InfraLidarConfig, record: SiteRecord, in_use: Forest, generated: tuple[Examples, Examples]
) -> Outcome:
    """Train the site's forest on the first part of a recording and evaluate it on the last.

    generated: generated clusters for training, and others to measure what the new forest has unlearned.
    """
    learned, held_out = divide(record)
    to_grow, unseen = generated
    counts = np.bincount(learned.labels).tolist()
    provenance = {"source": "generated clusters and those of a site", "site_clusters": counts}
    provenance["instead_of"] = in_use.digest
    forest = grow(join(to_grow, site_examples(record, learned)), provenance)
    sure = config.classifier.min_confidence
    figures = [
        judge(called(one, held_out.x, FEATURES, sure), held_out, called(one, unseen.x, FEATURES, sure), unseen.labels)
        for one in (in_use, forest)
    ]
    before, after = figures
    return Outcome(forest, learned, held_out, before, after, list(objections(before, after, held_out)))
