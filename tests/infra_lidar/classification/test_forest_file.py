"""The file of a forest: written whole under its name, or not at all; damaged ones are told."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
import pytest

from services.infra_lidar.classification.forest import ModelError, load_forest
from tests.infra_lidar.classification.test_classifier import rewritten, two_stumps


def test_a_forest_is_written_under_the_name_that_was_given(tmp_path: Path) -> None:
    two_stumps().save(tmp_path / "my_model")
    assert [path.name for path in tmp_path.iterdir()] == ["my_model"]
    assert load_forest(tmp_path / "my_model").digest == two_stumps().digest


def test_a_forest_that_cannot_be_written_leaves_the_one_in_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    two_stumps().save(tmp_path / "f.npz")

    def full_disk(file: IO[bytes], **arrays: np.ndarray) -> None:
        (Path(file) if isinstance(file, Path) else Path(file.name)).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(OSError, match="No space left"):
        two_stumps().save(tmp_path / "f.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["f.npz"]
    assert load_forest(tmp_path / "f.npz").digest == two_stumps().digest


def _damaged(whole: bytes) -> Iterator[bytes]:
    """The file cut off, and with a few bytes zeroed, at many places."""
    for at in np.linspace(0, len(whole) - 1, 60).astype(int):
        yield whole[:at]
        for length in (1, 4, 64):
            yield whole[:at] + bytes(min(length, len(whole) - at)) + whole[at + length :]


def test_a_damaged_file_is_a_model_error_or_the_same_model(tmp_path: Path) -> None:
    path = tmp_path / "f.npz"
    two_stumps().save(path)
    refused = []
    for data in _damaged(path.read_bytes()):
        path.write_bytes(data)
        try:
            assert load_forest(path).digest == two_stumps().digest
        except ModelError as error:
            refused.append(str(error))
    assert len(refused) > 120
    assert all(line.startswith(f"{path}: ") for line in refused)


@pytest.mark.parametrize(
    "header",
    [
        "null", "[]", "7", '"x"', "{}", '{"classes": 5}',
        '{"classes": null, "features": [], "provenance": {}, "sha256": ""}',
        '{"classes": [], "features": 1.5, "provenance": {}, "sha256": ""}',
        '{"classes": [], "features": [], "provenance": 3, "sha256": ""}',
        '{"classes": [], "features": [], "provenance": {}}',
        '{"classes": [], "features": [], "provenance": {}, "sha256": null}',
    ],
)  # fmt: skip
def test_an_odd_header_is_a_model_error(header: str, tmp_path: Path) -> None:
    two_stumps().save(tmp_path / "f.npz")
    with pytest.raises(ModelError, match=r"f\.npz: (not a forest|damaged)"):
        load_forest(rewritten(tmp_path / "f.npz", header=np.frombuffer(header.encode(), np.uint8)))


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY", "array", bytes(500)])
def test_a_file_of_another_kind_is_a_model_error(content: bytes | str, tmp_path: Path) -> None:
    path = tmp_path / "f.npz"
    if isinstance(content, str):
        with path.open("wb") as file:
            np.save(file, np.zeros(5))
    else:
        path.write_bytes(content)
    with pytest.raises(ModelError, match=r"f\.npz: not a forest"):
        load_forest(path)
