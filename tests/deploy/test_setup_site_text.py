"""What `spotter setup` writes into a site file: its own keys, and nothing else changes."""

from __future__ import annotations

import tomllib
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from spotter_tools.setup.site_text import NOT_FITTED, Entry, completed, with_section, with_value

WRITTEN = """# ours
namespace = "yard"  # a name

[hosts.jetson0]
address = "10.0.0.3"   # on the switch
[hosts.jetson0.services.lidar]   # LD06
# source = "serial:/dev/old"
source = "serial:/dev/ttyUSB0" # the first one
set = ["zones.look_ahead_m=2.5"]
[hosts.pi0]
address = "10.0.0.2"
port = 7449
"""


def test_what_a_file_says_stays() -> None:
    sources = {"lidar": "serial:/dev/new", "camera": "", "radar": NOT_FITTED}
    entry, services = Entry("jetson0", "10.0.0.9", sources, {"lidar": ("a.b=1",)}), [*sources, "fusion"]
    text = completed(WRITTEN, entry, services, open_mode=False)
    assert text.splitlines()[:2] == ["# ours", 'namespace = "yard"  # a name']
    assert 'source = "serial:/dev/new" # the first one' in text
    assert '# source = "serial:/dev/old"' in text
    assert 'address = "10.0.0.9"   # on the switch' in text
    read = tomllib.loads(text)
    assert read["hosts"]["pi0"] == {"address": "10.0.0.2", "port": 7449}
    assert read["hosts"]["jetson0"]["services"] == {
        "lidar": {"source": "serial:/dev/new", "set": ["a.b=1"]},
        "camera": {},  # expected, and refused at start until its source is there
        "fusion": {},
    }
    assert "accept_simulated" not in read
    assert completed(text, entry, services, open_mode=False) == text


def test_a_source_that_is_not_live_makes_a_site_for_trials() -> None:
    read = tomllib.loads(
        completed(WRITTEN, Entry("pi0", "x", {"radar": "spi:emulator"}, {}), ["radar"], open_mode=True)
    )
    assert read["accept_simulated"] is True
    assert read["tls"] == {"enabled": False}


KEYS = st.sampled_from(["a", "b", "set"])
SECTIONS = st.sampled_from(["", "x", "x.y", "hosts.jetson0", "hosts.jetson0.services.lidar"])
VALUES = st.one_of(
    st.booleans(), st.text(st.characters(codec="ascii"), max_size=8), st.lists(st.just("q=1"), max_size=2)
)


@given(st.lists(st.tuples(SECTIONS, KEYS, VALUES), max_size=8))
def test_a_value_that_was_set_is_read_back(steps: list[tuple[str, str, Any]]) -> None:
    text, expected = WRITTEN, {}
    for section, key, value in steps:
        text = with_value(text, section, key, value)
        expected[section, key] = value
    read = tomllib.loads(text)
    for (section, key), value in expected.items():
        place = read
        for part in section.split(".") if section else ():
            place = place[part]
        assert place[key] == value
    assert read["hosts"]["pi0"]["port"] == 7449


def test_a_section_is_added_once() -> None:
    once = with_section(WRITTEN, "hosts.jetson0.services.fusion")
    assert with_section(once, "hosts.jetson0.services.fusion") == once
    assert with_section(once, "hosts.pi0") == once
