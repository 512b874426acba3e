"""A host installs what its extra declares and no more: so no service may import anything else.

Every ``import`` statement of every module is read (also those inside functions) and held against the distribution's
own metadata, once per extra. Imports behind ``if TYPE_CHECKING`` count too: they are needed by nobody at run time, but
a reader should not find names there that the host cannot resolve.
"""

from __future__ import annotations

import ast
import importlib.metadata
import re
import sys
from functools import cache
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
OURS = {"common", "services", "spotter_client", "spotter_sim", "spotter_tools"}
DISTRIBUTION_OF = {
    "zenoh": "eclipse-zenoh",
    "serial": "pyserial",
    "cv2": "opencv-python-headless",
    "sklearn": "scikit-learn",
    "foxglove": "foxglove-sdk",
    "prometheus_client": "prometheus-client",
    "rerun": "rerun-sdk",
    "can": "python-can",
}

# Which extras a file may count on, most specific folder or file first; everything else has the base only.
EXTRAS_OF = {
    "services/radar_pi/chip/hardware.py": {"radar-pi", "radar-hw"},
    "services/radar_pi/plot.py": {"radar-pi", "plot"},
    "services/radar_pi": {"radar-pi"},
    "services/jetson/camera/training/train_demo_network.py": {"torch only: a script with its own header"},
    "services/jetson/gate/can_output.py": {"jetson", "vehicle"},
    "services/jetson/gate/gpio_lines.py": {"jetson", "vehicle"},
    "services/jetson/ego/can_signals.py": {"jetson", "vehicle"},
    "services/jetson/ego/devices.py": {"jetson", "vehicle"},
    "services/jetson/ego/imu_chips.py": {"jetson", "vehicle"},
    "services/jetson": {"jetson"},
    "services/infra_lidar/input/bags.py": {"infra-lidar", "ros2"},
    "services/infra_lidar/input/las.py": {"infra-lidar", "las"},
    "services/infra_lidar/training/refine.py": {"infra-lidar", "train"},
    "services/infra_lidar/training/train.py": {"infra-lidar", "train"},
    "services/infra_lidar/training/evaluate.py": {"infra-lidar", "train"},
    "services/infra_lidar/adaptation/site_forest.py": {"infra-lidar", "train"},
    "services/infra_lidar/plot.py": {"infra-lidar", "plot", "jetson"},  # an MP4 where OpenCV happens to be
    "services/infra_lidar/training/evaluate_plots.py": {"infra-lidar", "train"},
    "services/infra_lidar": {"infra-lidar"},
    "services/blackbox": {"record"},
    "common/recording/foxglove.py": {"record", "foxglove"},
    "common/recording/rerun_scene.py": {"record", "rerun"},
    "common/recording": {"record"},
    "common/ros2": {"ros2"},
    "common/security/authority.py": {"keys"},
    "spotter_tools/cpm": {"cpm"},
    "spotter_tools/plots": {"plot"},
    "spotter_tools/prove": {"jetson", "radar-pi", "plot"},
    "spotter_sim/backdrop.py": {"jetson"},
    "spotter_sim/camera.py": {"jetson"},
    "spotter_sim/lidar128.py": {"infra-lidar"},
    "spotter_sim/lidar128_kernels.py": {"infra-lidar"},
}
SCRIPTS_OF_THEIR_OWN = {
    "services/jetson/camera/training/train_demo_network.py",
    "services/jetson/gate/firmware/micropython/main.py",  # runs on the board
}


@cache
def required(extra: str | None) -> frozenset[str]:
    """Distributions that ``spotter[extra]`` declares, our own other extras followed."""
    names: set[str] = set()
    for line in importlib.metadata.requires("spotter") or []:
        requirement, _, marker = line.partition(";")
        wanted = re.search(r"""extra\s*==\s*['"]([^'"]+)['"]""", marker)
        if (wanted.group(1) if wanted else None) != extra:
            continue
        name = re.match(r"[A-Za-z0-9_.-]+", requirement)
        assert name is not None
        if name.group() == "spotter":
            for inner in re.findall(r"[a-z-]+", requirement[requirement.index("[") :]):
                names |= required(inner)
        else:
            names.add(name.group().lower())
    return frozenset(names)


def allowed_for(path: str) -> frozenset[str]:
    extras: set[str] = set()
    for place in (path, *(str(parent) for parent in Path(path).parents)):
        if place in EXTRAS_OF:
            extras = EXTRAS_OF[place]
            break
    return required(None).union(*(required(extra) for extra in extras))


def imported_by(path: Path) -> set[str]:
    """Top-level names of all imports of a file that are neither the standard library's nor ours."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.split(".")[0])
    return (
        names
        - set(sys.stdlib_module_names)
        - {"common", "services", "spotter_client", "spotter_sim", "spotter_tools", "__future__"}
    )


def our_files() -> list[str]:
    found = [
        *REPOSITORY.glob("common/**/*.py"),
        *REPOSITORY.glob("services/**/*.py"),
        *REPOSITORY.glob("spotter_*/**/*.py"),
    ]
    return sorted(str(path.relative_to(REPOSITORY)) for path in found)


def own_imports(path: str) -> set[str]:
    """Our own modules that a file imports at its top level, as paths: they need their extras as well."""
    paths: set[str] = set()
    for node in ast.parse((REPOSITORY / path).read_text()).body:
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            modules = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for module in modules:
            for candidate in (module.replace(".", "/") + ".py", module.replace(".", "/") + "/__init__.py"):
                if (REPOSITORY / candidate).exists():
                    paths.add(candidate)
    return paths


@pytest.mark.parametrize("path", our_files())
def test_a_file_imports_only_what_its_extra_declares(path: str) -> None:
    if path in SCRIPTS_OF_THEIR_OWN:
        pytest.skip("a script that no service imports: run by hand, or on a board")
    used = {DISTRIBUTION_OF.get(name, name) for name in imported_by(REPOSITORY / path)}
    # The command line may look into optional packages when a command that needs them is called.
    undeclared = used - allowed_for(path)
    if path.startswith("spotter_tools/cli/"):
        undeclared -= required("laptop") | required("keys") | required("foxglove") | required("rerun")
    assert not undeclared, f"{path} imports {sorted(undeclared)}, which its extra does not declare"


@pytest.mark.parametrize(
    ("start", "extra"),
    [
        ("services/radar_pi/__main__.py", "radar-pi"),
        ("services/jetson/lidar/__main__.py", "jetson"),
        ("services/jetson/camera/__main__.py", "jetson"),
        ("services/jetson/fusion/__main__.py", "jetson"),
        ("services/jetson/dashboard/__main__.py", "jetson"),
        ("services/infra_lidar/__main__.py", "infra-lidar"),
        ("services/jetson/ego/__main__.py", "jetson"),
        ("services/jetson/gate/__main__.py", "jetson"),
        ("services/blackbox/__main__.py", "record"),
        ("spotter_tools/cli/__main__.py", None),
    ],
)
def test_a_service_starts_with_its_own_extra_alone(start: str, extra: str | None) -> None:
    """Whatever the entry point imports when it starts, directly or through our modules, its extra declares."""
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        waiting += own_imports(path)
    declared = required(None) | (required(extra) if extra else frozenset())
    for path in sorted(seen):
        tree = ast.parse((REPOSITORY / path).read_text())
        top_level = {
            name.split(".")[0]
            for node in tree.body
            for name in (
                [alias.name for alias in node.names] if isinstance(node, ast.Import)
                else [node.module] if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module
                else []
            )
        } - set(sys.stdlib_module_names) - OURS  # fmt: skip
        undeclared = {DISTRIBUTION_OF.get(name, name) for name in top_level} - declared
        assert not undeclared, f"{start} needs {path}, which imports {sorted(undeclared)} when it is loaded"


def test_nobody_else_owns_our_names() -> None:
    """``common`` and ``services`` are generic names: fail as soon as another distribution installs one of them."""
    owners = importlib.metadata.packages_distributions()
    for name in OURS:
        assert set(owners.get(name, ["spotter"])) == {"spotter"}


PURE = ("parser.py", "pipeline.py")
FORBIDDEN_IN_PURE = {"zenoh", "serial", "socket", "subprocess", "spidev", "gpiod", "time", "threading"}


@pytest.mark.parametrize("path", [path for path in our_files() if path.endswith(PURE) and "services" in path])
def test_parsers_and_pipelines_are_pure(path: str) -> None:
    """No device, no network, no clock, no thread: time comes in as an argument."""
    tree = ast.parse((REPOSITORY / path).read_text())
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.split(".")[0])
            names |= {alias.name for alias in node.names} & {"utc_ns", "monotonic_s", "Service"}
    assert not names & (FORBIDDEN_IN_PURE | {"utc_ns", "monotonic_s", "Service"})
