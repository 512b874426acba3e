"""What a shared machine may do to a test with deadlines."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

CONFTEST = Path(__file__).with_name("conftest.py").read_text()
FAILS_ONCE = """
import pathlib, pytest

@pytest.fixture
def counted(tmp_path_factory):
    return pathlib.Path({folder!r}) / "times"

@pytest.mark.{mark}
def test_second_time_lucky(counted):
    times = len(counted.read_text()) if counted.exists() else 0
    counted.write_text("x" * (times + 1))
    assert times > {bad}
"""


@pytest.mark.parametrize(
    ("mark", "stolen", "bad", "passed", "told"),
    [
        ("system", True, 0, 1, 1),  # the machine stood still: once more
        ("system", False, 0, 0, 0),  # nobody took anything: what failed has failed
        ("slow", True, 0, 0, 0),  # a test without deadlines
        ("system", True, 9, 0, 2),  # it fails every time
    ],
)
def test_what_fails_while_others_have_the_processors_is_tried_again(
    pytester: pytest.Pytester,
    monkeypatch: pytest.MonkeyPatch,
    mark: str,
    stolen: bool,
    bad: int,
    passed: int,
    told: int,
) -> None:
    grows = "import itertools\n_SECONDS = itertools.count()\ndef taken_s() -> float:\n    return next(_SECONDS) * 1.0\n"
    pytester.makeconftest(CONFTEST + (grows if stolen else "\ndef taken_s() -> float:\n    return 0.0\n"))
    pytester.makeini("[pytest]\nmarkers = system\n    slow\n")
    pytester.makepyfile(FAILS_ONCE.format(folder=str(pytester.path), mark=mark, bad=bad))
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=passed, failed=1 - passed)
    assert result.stdout.str().count("REPEATED") == told


def test_time_taken_is_that_of_the_kernel(tmp_path: Path) -> None:
    spec = spec_from_file_location("the_conftest", Path(__file__).with_name("conftest.py"))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    stat = tmp_path / "stat"
    stat.write_text("cpu  513438 104 45952 887613 1989 0 1649 250 0 0\ncpu0 1 2 3 4 5 6 7 8 9 10\n")
    assert module.taken_s(str(stat)) == pytest.approx(250 / 100, rel=0.01)
    assert module.taken_s(str(tmp_path / "none")) == 0.0
