"""A made-up site from recording to forest: its barrier, which the forest in use calls a lorry, is unlearned."""

import threading

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("sklearn")

from common.bus.status import Report
from common.config import ConfigError
from services.infra_lidar.__main__ import app
from services.infra_lidar.adaptation.adapt import learn_site, record_site, split
from services.infra_lidar.adaptation.awaited import awaited
from services.infra_lidar.adaptation.labels import label_site
from services.infra_lidar.adaptation.recorder import SiteRecord, SiteRecorder, TrackHistory
from services.infra_lidar.adaptation.site_forest import FEATURES, Examples, grow
from services.infra_lidar.classification.classifier import SHIPPED_MODEL, model_path
from services.infra_lidar.config import BackgroundConfig, CalibrationConfig, ClassifierConfig, InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline

LARGE = 2
MIDDLE = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [4.0, 4.0], [-4.0, 0.0]])  # of each class, two features
BARRIER = np.array([0.0, 7.0])  # beyond the lorries: no other background is there


def _x(rng, middle, n):
    x = np.zeros((n, len(FEATURES)), np.float32)
    x[:, [FEATURES.index("x_range"), FEATURES.index("z_top")]] = rng.normal(middle, 0.5, (n, 2))
    return x


def _generated(seed, n=60):
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.arange(5), n)
    return Examples(_x(rng, np.repeat(MIDDLE, n, axis=0), 5 * n), labels, np.arange(5 * n), np.ones(5 * n))


def _site(users, seed=5):
    """Two minutes: a barrier in each of 240 revolutions, and lorries of ten clusters each that pass one by one."""
    rng = np.random.default_rng(seed)
    sampled_ns = np.arange(240) * 500_000_000
    barrier, lorries = _x(rng, BARRIER, 240), _x(rng, MIDDLE[LARGE], 10 * users)
    begins = np.linspace(0, 110e9, users)
    stamps = np.concatenate((sampled_ns, (begins[:, None] + np.arange(10) * 500_000_000).ravel()))
    tracks = {n: TrackHistory(int(b), int(b + 5e9), np.zeros(3), 50 * np.eye(5)[LARGE], 60.0, 50, 50, 50)
              for n, b in enumerate(begins)}  # fmt: skip
    box = np.tile(np.array([0, 0, 0, 12.0, 1.0, 1.5, 0, 0], np.float32), (len(stamps), 1))
    return SiteRecord(
        x=np.concatenate((barrier, lorries)), called=np.tile(np.eye(5)[LARGE], (len(stamps), 1)), box=box,
        stamp_ns=stamps.astype(np.int64), track=np.concatenate((np.full(240, -1), np.repeat(np.arange(users), 10))),
        standing=np.concatenate((np.ones(240), np.zeros(10 * users))), tracks=tracks, sampled_ns=sampled_ns,
    )  # fmt: skip


@pytest.fixture(scope="module")
def in_use():
    return grow(_generated(1), {"source": "a test"})


def test_the_barrier_is_unlearned_and_lorries_are_not(in_use):
    outcome = learn_site(InfraLidarConfig(), _site(40), in_use, (_generated(2), _generated(3)))
    assert outcome.objections == []
    assert outcome.before.false > 0.8
    assert outcome.after.false < 0.1
    assert outcome.after.right > 0.9
    assert outcome.forest.provenance["instead_of"] == in_use.digest


def test_a_site_without_traffic_is_refused(in_use):
    outcome = learn_site(InfraLidarConfig(), _site(0), in_use, (_generated(2), _generated(3)))
    assert "0 road users moved" in outcome.objections[0]


def test_a_forest_that_forgets_a_class_is_refused(in_use):
    without = _generated(2)
    kept = without.labels != 4
    without = Examples(*(column[kept] for column in without))
    outcome = learn_site(InfraLidarConfig(), _site(40), in_use, (without, _generated(3)))
    assert any("pedestrian on generated streets falls" in reason for reason in outcome.objections)


def test_nothing_that_is_judged_by_was_learned_from():
    record = _site(40)
    learned, held_out, revolutions = split(record, label_site(record))
    assert not set(learned.rows) & set(held_out.rows)
    assert revolutions == pytest.approx(60, abs=1)
    users = [set(part.groups[part.labels == LARGE].tolist()) for part in (learned, held_out)]
    assert not users[0] & users[1]
    assert min(map(len, users)) > 5


def test_the_site_forest_is_used_while_it_is_there_and_undone_with_one_command(in_use, tmp_path):
    path = tmp_path / "site.npz"
    config = ClassifierConfig(site_model=str(path))
    assert model_path(config) == SHIPPED_MODEL
    in_use.save(path)
    assert model_path(config) == path
    undo = ["--set", f"classifier.site_model={path}", "adapt", "--undo"]
    refused = CliRunner().invoke(app, undo)  # not written by adapt
    assert "was not made by" in str(refused.exception)
    assert path.exists()
    grow(_generated(1), {"instead_of": "x"}).save(path)
    assert CliRunner().invoke(app, undo).exit_code == 0
    assert model_path(config) == SHIPPED_MODEL
    assert "nothing to undo" in str(CliRunner().invoke(app, undo).exception)


def test_a_forest_that_adapt_has_not_made_is_not_overwritten(in_use, tmp_path):
    path = tmp_path / "trained.npz"
    in_use.save(path)
    refused = CliRunner().invoke(app, ["--source", "file:no_recording", "adapt", "-o", str(path)])
    assert "was not made by `spotter-infra-lidar adapt`: choose another file" in str(refused.exception)


def _frames(count, ended):
    yield from range(count)
    ended.wait(20.0)


def test_a_source_that_falls_silent_is_not_waited_for():
    ended, report = threading.Event(), Report("adapt")
    with pytest.raises(ValueError, match=r"no frame came for 0\.1 s"):
        list(awaited(_frames(0, ended), report, 0.1))
    report.state("disconnected", "no packets on UDP port 2368")
    with pytest.raises(ValueError, match="no packets on UDP port 2368"):
        list(awaited(_frames(0, ended), report, 0.1))
    assert list(awaited(_frames(3, ended), report, 0.1)) == [0, 1, 2]
    ended.set()
    assert list(awaited(_frames(3, ended), report)) == [0, 1, 2]


def test_what_a_source_raises_is_raised_where_its_frames_are_taken():
    def damaged():
        yield 1
        raise ValueError("cut off")

    frames = awaited(damaged(), Report("adapt"))
    assert next(frames) == 1
    with pytest.raises(ValueError, match="cut off"):
        next(frames)


@pytest.mark.parametrize(
    ("name", "says"),
    [("site", "site: the name has to end in .npz"), ("none/site.npz", "no folder none")],
)
def test_where_it_cannot_be_written_is_said_before_the_recording(name, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = CliRunner().invoke(app, ["--source", "file:no_recording", "adapt", "-o", name])
    assert says in str(refused.exception)


def test_without_the_extra_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    refused = CliRunner().invoke(app, ["--source", "file:x", "adapt", "-o", str(tmp_path / "site.npz")])
    assert "train, evaluate and adapt need the extra `train`, which is not installed: uv" in str(refused.exception)


@pytest.mark.slow
def test_on_a_real_motorway_trees_and_barriers_are_clutter_and_cars_in_their_lanes_are_not(recording):
    frames = sorted(recording("roadside-lidar80").glob("frame_*.npz"))
    config = InfraLidarConfig(
        background=BackgroundConfig(enabled=False), calibration=CalibrationConfig(height_min_m=2.0, max_tilt_deg=10.0)
    )
    pipeline, recorder = InfraLidarPipeline(config), SiteRecorder(FEATURES, config.ground.range_max_m)
    for number, path in enumerate(frames):  # seconds apart: no track continues
        with np.load(path) as stored:
            recorder.add(pipeline.process(number * 10**10 + 1, stored["xyz"].astype(np.float32)), {})
    record = recorder.record()
    labels = label_site(record)
    clutter = np.zeros(len(record.x), bool)
    clutter[labels.rows] = True
    y_m, car = np.abs(record.box[:, 1]), record.called[:, 1] > 0.9
    assert set(np.unique(labels.labels)) == {0}
    assert np.mean(clutter[y_m > 18.0]) > 0.6
    assert np.mean(clutter[(y_m > 3.0) & (y_m < 15.0) & car]) == 0.0


def test_a_source_that_is_not_there_is_told_before_anything_is_compiled(monkeypatch, tmp_path):
    monkeypatch.setattr("services.infra_lidar.adaptation.adapt.warm_up", lambda *_: pytest.fail("compiled first"))
    with pytest.raises(ConfigError, match="no_recording does not exist"):
        record_site(InfraLidarConfig(source="file:no_recording"), 1.0)
    refused = CliRunner().invoke(app, ["--source", "file:no_recording", "adapt", "-o", str(tmp_path / "site.npz")])
    assert str(refused.exception) == "source file:no_recording: no_recording does not exist"
