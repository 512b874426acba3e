"""--plot and --record: a picture with something in it, and a recording that plays again."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from services.radar_pi import tools
from services.radar_pi.__main__ import app, main
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.recording import Recorder, open_recording
from spotter_sim.bgt60 import LEAKAGE, Target, simulate


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path, waveform = tmp_path / "walk.radar", WaveformConfig()
    with Recorder(path, waveform) as recorder:
        for i in range(24):
            scene = [*LEAKAGE, Target(4.0 - 0.14 * i, -1.4, 0.2)]
            recorder.write(i * 100_000_000, 0, simulate(scene, simulator_waveform(waveform), seed=i))
    return path


def png_size(path: Path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    return struct.unpack(">II", data[16:24])  # type: ignore[return-value]


def test_plot_draws_a_picture(recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    result = CliRunner().invoke(app, ["--source", f"file:{recording}?rate=0", "plot", str(tmp_path / "out.png")])
    assert result.exit_code == 0, result.output
    assert f"{tmp_path / 'out.png'}: the last of " in result.output
    width, height = png_size(tmp_path / "out.png")
    assert width > 800
    assert height > 400


def test_record_writes_what_the_source_gave(recording: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.radar"
    arguments = ["--source", f"file:{recording}?rate=0", "record", str(copy), "--frames", "7"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert f"{copy}: 7 frames" in result.output
    assert np.array_equal(open_recording(copy).frames, open_recording(recording).frames[:7])


def test_a_recording_is_not_recorded_onto_itself(recording: Path, tmp_path: Path) -> None:
    before = recording.read_bytes()
    (tmp_path / "link.radar").symlink_to(recording)
    for name in ("walk.radar", "link.radar"):
        arguments = ["--source", f"file:{recording}?rate=0", "record", str(tmp_path / name)]
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 2
        assert f"{tmp_path / name} is the source itself" in result.output
        assert recording.read_bytes() == before


def test_an_older_recording_is_kept_while_no_frame_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "open_source", lambda config, report: iter(()))
    old = tmp_path / "old.radar"
    old.write_bytes(b"older")
    result = CliRunner().invoke(app, ["--source", "sim:crossing", "record", str(old)])
    assert result.exit_code == 2
    assert "not one frame came" in result.output
    assert old.read_bytes() == b"older"


@pytest.mark.parametrize("flag", ["--plot", "--record"])
def test_a_wrong_recording_ends_with_code_two_and_the_reason(
    flag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.radar").write_bytes(b"not a recording")
    arguments = ["--source", f"file:{tmp_path / 'x.radar'}", flag, str(tmp_path / "out.png")]
    monkeypatch.setattr("sys.argv", ["spotter-radar", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "SPOTRADR" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "name", "said"),
    [
        ("plot", "none/out.png", "no folder"),
        ("plot", "out.xyz", "the name has to end in .png or .svg or .pdf"),
        ("record", "none/out.radar", "no folder"),
    ],
)
def test_a_file_that_cannot_be_written_is_said_before_the_work(
    recording: Path, tmp_path: Path, command: str, name: str, said: str
) -> None:
    result = CliRunner().invoke(app, ["--source", f"file:{recording}?rate=0", command, str(tmp_path / name)])
    assert (result.exit_code, said in result.output, len(result.output.splitlines())) == (2, True, 1), result.output


def test_show_config_still_works() -> None:
    result = CliRunner().invoke(app, ["--show-config", "--set", "cfar.kind=os"])
    assert result.exit_code == 0
    assert '"kind": "os"' in result.output
