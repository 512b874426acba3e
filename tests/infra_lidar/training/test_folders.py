"""`train` and `evaluate` on folders and files that are none: each answers with one sentence."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

pytest.importorskip("sklearn", reason="needs the train extra")

from common.config import ConfigError
from services.infra_lidar.classification.classifier import SHIPPED_MODEL
from services.infra_lidar.classification.forest import load_forest
from services.infra_lidar.command_line import write_forest
from services.infra_lidar.training import commands
from services.infra_lidar.training.clusters import LabelledClusters
from services.infra_lidar.training.folders import expect_classes, read_part
from services.infra_lidar.training.held_out import held_out_table
from services.infra_lidar.training.varied import generated_clusters

RNG = np.random.default_rng(0)


def write(folder: Path, name: str, count: int = 3, scale: float = 1.0, columns: int = 3, suffix: str = ".bin") -> None:
    folder = folder / name
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(count):
        (RNG.uniform(-1, 1, (24, columns)) * scale).astype(np.float32).tofile(folder / f"{k:04d}{suffix}")


def part(folder: Path, name: str = "train") -> Path:
    write(folder / name, "car")
    write(folder / name, "pedestrian")
    return folder


def of(change: Callable[[Path], object]) -> Callable[[Path], Path]:
    """A good folder ``data`` with something changed."""

    def make(tmp_path: Path) -> Path:
        change(part(tmp_path / "data"))
        return tmp_path / "data"

    return make


def file_instead(tmp_path: Path) -> Path:
    (tmp_path / "data").write_text("not a folder")
    return tmp_path / "data"


def empty(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    return tmp_path / "data"


def classes_at_the_top(tmp_path: Path) -> Path:
    write(tmp_path / "data", "car")
    return tmp_path / "data"


def empty_part(tmp_path: Path) -> Path:
    (tmp_path / "data" / "train").mkdir(parents=True)
    return tmp_path / "data"


def other_classes_only(tmp_path: Path) -> Path:
    write(tmp_path / "data" / "train", "tree")
    return tmp_path / "data"


def no_files(tmp_path: Path) -> Path:
    (tmp_path / "data" / "train" / "car").mkdir(parents=True)
    return tmp_path / "data"


def tiny(tmp_path: Path) -> Path:
    (tmp_path / "data" / "train" / "car").mkdir(parents=True)
    (tmp_path / "data" / "train" / "car" / "a.bin").write_bytes(bytes(12))
    return tmp_path / "data"


def millimetres(tmp_path: Path) -> Path:
    for name in ("car", "pedestrian"):
        write(tmp_path / "data" / "train", name, scale=1000.0)
    return tmp_path / "data"


def more_columns(*brightest: float) -> Callable[[Path], Path]:
    """x y z and more: 24 rows of four are 32 rows of three, of five 40; their sizes give them away."""

    def make(tmp_path: Path) -> Path:
        part(tmp_path / "data")
        for path in (tmp_path / "data" / "train" / "car").iterdir():
            more = [RNG.uniform(0, most, 24) for most in brightest]
            np.column_stack([np.fromfile(path, np.float32).reshape(24, 3), *more]).astype(np.float32).tofile(path)
        return tmp_path / "data"

    return make


def of_length(name: str, length: float) -> Callable[[Path], object]:
    return lambda data: np.linspace(0, [length, 0, 0], 24).astype(np.float32).tofile(data / "train" / name)


def kilometres(tmp_path: Path) -> Path:
    for name in ("car", "pedestrian"):
        write(tmp_path / "data" / "train", name, scale=0.001)
    return tmp_path / "data"


def points_at_zero(tmp_path: Path) -> Path:
    for name in ("car", "pedestrian"):
        write(tmp_path / "data" / "train", name, scale=0.0)
    return tmp_path / "data"


WRONG: list[tuple[Callable[[Path], Path], str]] = [
    (lambda tmp_path: tmp_path / "data", "data: no such folder; expected {train,test}/<class>/*.bin"),
    (file_instead, "data: a file; expected"),
    (empty, "data: no folder train in it, but nothing"),
    (classes_at_the_top, "data: no folder train in it, but car"),
    (empty_part, "data/train: expected a folder for each class"),
    (other_classes_only, "data/train: no class of ours: tree; known: background, bicycle,"),
    (of(lambda data: write(data / "train", "tank")), "data/train: no class of ours: tank; known: background"),
    (of(lambda data: write(data / "train", "car", suffix=".npy")), "not a .bin of float32 x y z (3 such files)"),
    (of(lambda data: (data / "train/car/a.bin").write_bytes(bytes(31))), "rows of 12 bytes, got 31 bytes"),
    (
        of(lambda data: (data / "train/car/a.bin").write_bytes(b"\xff" * 120)),
        "expected float32 x y z, finite, got other numbers",
    ),
    (no_files, "data/train: no .bin files in car"),
    (tiny, "data/train: none of 1 clusters has 5 points"),
    (millimetres, "expected metres, x y z; are these millimetres"),
    (more_columns(255.0), "train/car: expected float32 x y z, found numbers that look like rows of 4"),
    (more_columns(3.0), "train/car: expected float32 x y z, found numbers that look like rows of 4"),
    (more_columns(255.0, 63.0), "train/car: expected float32 x y z, found numbers that look like rows of 5"),
    (kilometres, "expected metres, x y z; are these kilometres?"),
    (points_at_zero, "half of the clusters are at most 0 long: expected metres"),
    (of(of_length("car/0000.bin", 61.0)), "0000.bin: 61 m long, expected one road user of at most 60 m"),
]


@pytest.mark.parametrize(("make", "words"), WRONG)
def test_every_wrong_folder_is_one_sentence(make: Callable[[Path], Path], words: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as raised:
        read_part(make(tmp_path), "train")
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("points", [5, 8, 20, 40])
def test_centred_clusters_are_read_whatever_their_number_of_points(points: int, tmp_path: Path) -> None:
    """Nothing tells x from y and z, and all files are rows of four and five as well."""
    for name in ("car", "pedestrian"):
        (tmp_path / "data" / "train" / name).mkdir(parents=True)
        for k in range(5):
            cluster = RNG.uniform(-1, 1, (points, 3)).astype(np.float32)
            cluster.tofile(tmp_path / "data" / "train" / name / f"{k}.bin")
    assert len(read_part(tmp_path / "data", "train")) == 10


def test_background_may_be_long(tmp_path: Path) -> None:
    data = part(tmp_path / "data")
    write(data / "train", "background")
    of_length("background/0000.bin", 61.0)(data)
    assert len(read_part(data, "train")) == 9


def test_hidden_files_and_notes_do_not_disturb(tmp_path: Path) -> None:
    data = part(tmp_path / "data")
    for name in ("train/.DS_Store", "train/car/README.md", "train/car/.hidden.npy"):
        (data / name).write_text("a note")
    assert len(read_part(data, "train")) == 6


@pytest.mark.parametrize(("names", "words"), [(["car"], "only car: a forest needs"), (["7_a", "7_b"], "of one group")])
def test_what_cannot_be_learned_from_is_refused(names: list[str], words: str, tmp_path: Path) -> None:
    data = tmp_path / "data"
    if names == ["car"]:
        write(data / "train", "car")
    else:
        for kind in ("car", "pedestrian"):
            (data / "train" / kind).mkdir(parents=True)
            for name in names:
                RNG.uniform(-1, 1, (10, 3)).astype(np.float32).tofile(data / "train" / kind / f"{name}.bin")
    with pytest.raises(ConfigError, match=words):
        expect_classes(read_part(data, "train"), data / "train")


def run(*arguments: str) -> str:
    """What the command says when it ends with a wrong configuration."""
    app = typer.Typer()
    commands.add_commands(app)
    with pytest.raises(ConfigError) as raised:
        CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    return str(raised.value)


def test_the_commands_answer_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = str(part(tmp_path / "data"))
    assert "no such folder" in run("train", str(tmp_path / "nowhere"))
    assert "no folder" in run("train", data, "-o", str(tmp_path / "nowhere" / "forest.npz"))
    assert "my_model: the name has to end in .npz" in run("train", data, "-o", str(tmp_path / "my_model"))
    assert "no folder test in it, but train" in run("evaluate", data)
    assert "no such model file" in run("evaluate", data, "--model", str(tmp_path / "nothing.npz"))
    (tmp_path / "text.npz").write_text("text")
    assert "not a forest written by" in run("evaluate", data, "--model", str(tmp_path / "text.npz"))
    monkeypatch.setitem(sys.modules, "sklearn", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "need the extra `train`" in run("train", data)


def test_a_forest_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "there.npz").mkdir()
    with pytest.raises(ConfigError, match=r"there\.npz: cannot be written: Is a directory"):
        write_forest(load_forest(SHIPPED_MODEL), tmp_path / "there.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["there.npz"]


def test_the_table_of_what_was_held_out_by_hand() -> None:
    """Forty cars seen as such, ten pedestrians of which the calibration's curve turns five into cars."""
    labels = np.array([1] * 40 + [4] * 10)
    shares = np.zeros((50, 5))
    shares[:40, 1], shares[:40, 4] = 0.9, 0.1
    shares[40:45, 4], shares[40:45, 1] = 0.9, 0.1
    shares[45:, 4], shares[45:, 1] = 0.6, 0.4
    clusters = LabelledClusters(
        np.zeros((50, 3), np.float32), np.arange(51), np.zeros(50, np.float32), labels, np.arange(50) // 2
    )
    grid = np.tile(np.linspace(0, 1, 5), (5, 1))
    curves = grid.copy()
    curves[4] = [0.0, 0.0, 0.1, 0.2, 1.0]
    lines = list(held_out_table(shares, grid, curves, clusters))
    rows = {line.split()[0]: line.split() for line in lines}
    assert rows["car"][1:5] == ["40", "20", "1.000", "1.000"]
    assert rows["pedestrian"][1:5] == ["10", "5", "1.000", "0.500"]
    assert "few: its figures" in lines[2]
    assert lines[-1] == "calibration lowers recall: pedestrian 1.00 to 0.50"
    plain, after = (2 * 40 / (80 + wrong) + 2 * (10 - wrong) / (20 - wrong) for wrong in (0, 5))
    assert f"{plain / 2:.3f}" in lines[-2]
    assert f"{after / 2:.3f}" in lines[-2]


def test_generated_clusters_are_metres(tmp_path: Path) -> None:
    made = generated_clusters(1, 4)
    for k, label in enumerate(made.labels):
        folder = tmp_path / "data" / "train" / ("car" if label else "background")
        folder.mkdir(parents=True, exist_ok=True)
        made.points[made.offsets[k] : made.offsets[k + 1]].tofile(folder / f"{k}.bin")
    assert len(read_part(tmp_path / "data", "train")) == len(made)
