"""``--plot FILE`` among the options of a service."""

import pytest

from common.bus.service_app import flag_as_command


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ([], []),
        (["--source", "sim:empty"], ["--source", "sim:empty"]),
        (["--plot", "a.png"], ["plot", "a.png"]),
        (["--plot", "a.png", "--source", "sim:empty"], ["--source", "sim:empty", "plot", "a.png"]),
        (["--set", "a.b=1", "--plot", "a.png", "--frames", "3"], ["--set", "a.b=1", "plot", "a.png", "--frames", "3"]),
        (["--config=x.toml", "--plot", "a.png", "--set=a.b=1"], ["--config=x.toml", "--set=a.b=1", "plot", "a.png"]),
        (["plot", "a.png"], ["plot", "a.png"]),
    ],
)
def test_the_flag_becomes_the_subcommand(given, meant):
    assert flag_as_command(given, "plot") == meant
