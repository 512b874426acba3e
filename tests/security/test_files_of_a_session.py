"""A session with a certificate that cannot be: refused before anybody waits for a router."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.bus.session import build
from common.config import ConfigError, ZenohConfig
from common.security.authority import init, issue
from common.security.router_config import with_certificate
from spotter_tools.cli.router import _serve
from spotter_tools.ports import free_port


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    init(tmp_path, "site")
    issue(tmp_path, "pi0", "host")
    issue(tmp_path, "jetson0", "host")
    return tmp_path


def test_what_was_issued_is_taken(keys: Path) -> None:
    build(with_certificate(ZenohConfig(), keys, "pi0"))


@pytest.mark.parametrize("part", ["ca_certificate", "certificate", "private_key"])
def test_a_file_that_is_not_there_is_named(keys: Path, part: str) -> None:
    config = with_certificate(ZenohConfig(), keys, "pi0")
    path = Path(getattr(config, part))
    path.unlink()
    with pytest.raises(ConfigError) as refused:
        build(config)
    assert str(refused.value) == f"[zenoh] {part} = '{path}': No such file or directory"


@pytest.mark.parametrize(
    ("part", "found", "error_text"),
    [
        ("ca_certificate", b"nonsense", "expected a certificate in PEM"),
        ("certificate", b"nonsense", "expected a certificate in PEM and the private key that belongs to it"),
        ("private_key", b"nonsense", "expected a certificate in PEM and the private key that belongs to it"),
        ("private_key", "jetson0.key", "expected a certificate in PEM and the private key that belongs to it"),
    ],
)
def test_a_file_that_is_something_else_is_named(keys: Path, part: str, found: bytes | str, error_text: str) -> None:
    config = with_certificate(ZenohConfig(), keys, "pi0")
    path = Path(getattr(config, part))
    path.write_bytes(found if isinstance(found, bytes) else (keys / found).read_bytes())
    with pytest.raises(ConfigError) as refused:
        build(config)
    assert str(path) in str(refused.value)
    assert str(refused.value).endswith(error_text)


def test_a_router_does_not_blame_another_one_for_its_certificate(keys: Path, capsys: pytest.CaptureFixture) -> None:
    (keys / "pi0.crt").write_bytes(b"nonsense")
    config = with_certificate(ZenohConfig(mode="router", listen=(f"tls/127.0.0.1:{free_port()}",)), keys, "pi0")
    with pytest.raises(SystemExit) as ended:
        _serve(config, None)
    assert ended.value.code == 2
    assert "expected a certificate in PEM" in (stderr := capsys.readouterr().err)
    assert "another router" not in stderr
