"""Runs on a host of the lab and tries to get in, lie and flood; prints what was let in: {"revoked": false, ...}.

python attacker.py FOLDER laptop1    # an authorised laptop that went bad, with stolen and forged certificates
python attacker.py FOLDER pi0        # somebody who took over the Pi, as a client of its own router
"""

import contextlib
import json
import os
import shutil
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import zenoh

from benchmarks.lab_tap import session_on
from common.bus.session import close_session, open_session
from common.codec import encode
from common.config import ZenohConfig
from common.host.site import Site, load_site
from common.messages import LidarZone, LidarZones, RadarTracks
from common.security import authority
from common.security.router_config import with_certificate

AUTHORISED = "authorised"
FLOOD = 8_000
NONSENSE = (b"", b"\xc1", b"\x81\xa8stamp_ns", b"\x00" * 5_000_000)
LIE = encode(RadarTracks(stamp_ns=2**62, tracks=[], level="IMMINENT", settled=True, noise_floor_db=0.0))
NEAR = LidarZone(nearest_m=0.2, points=9, level="IMMINENT")
WALL = encode(LidarZones(stamp_ns=2**62, left=NEAR, centre=NEAR, right=NEAR, level="IMMINENT", raw_level="IMMINENT"))


def let_in(site: Site, host: str, config: ZenohConfig, patience_s: float = 1.0) -> bool:
    """A session comes up at this host's router and is told anything."""
    try:
        session = open_session(config, give_up_after_s=patience_s)
    except ConnectionError:
        return False
    replies = [reply for reply in session.get(f"{host}/*/info", timeout=1.0) if reply.ok is not None]
    close_session(session)
    return bool(replies)


def doors(folder: Path, site: Site) -> dict[str, bool]:
    """Every way to dial a router without a right to, all at once, since who is turned away waits a second; and one
    with."""
    keys, ways = folder / "keys", {}
    for host in site.hosts:
        endpoint = site.endpoint(host)
        ways[f"plain TCP to {host}"] = host, ZenohConfig(connect=(endpoint.replace("tls/", "tcp/"),))
        anonymous = {"transport/link/tls": {"root_ca_certificate": str(keys / "ca.crt")}}
        ways[f"no certificate to {host}"] = host, ZenohConfig(connect=(endpoint,), extra=anonymous)
    vehicle = ZenohConfig(connect=(site.endpoint("jetson0"),))
    ways["revoked"] = "jetson0", with_certificate(vehicle, keys, "revoked1")
    with tempfile.TemporaryDirectory() as elsewhere:
        for name, forged in (("another authority", _foreign), ("expired", _expired)):
            place = Path(elsewhere) / name
            forged(keys, place)
            ways[name] = "jetson0", with_certificate(vehicle, place, "laptop1")
        with ThreadPoolExecutor(len(ways)) as pool:
            found = dict(zip(ways, pool.map(lambda way: let_in(site, *way), ways.values()), strict=True))
    return {**found, AUTHORISED: let_in(site, "jetson0", with_certificate(vehicle, keys, "laptop1"), 20.0)}


def _foreign(keys: Path, place: Path) -> None:
    """It trusts the site; the site does not trust it."""
    authority.init(place, "elsewhere")
    authority.issue(place, "laptop1", "laptop")
    shutil.copy(keys / "ca.crt", place)


def _expired(keys: Path, place: Path) -> None:
    shutil.copytree(keys, place)
    authority.issue(place, "laptop1", "laptop", days=-1)


def lie(session: zenoh.Session, own: tuple[str, ...]) -> None:
    """Alarms, verdicts and tokens in the name of others, very often; nonsense there and on one's own keys."""
    others = [
        session.liveliness().declare_token(f"{who}/alive/liar") for who in ("jetson0/fusion", "infra0/infra_lidar")
    ]
    for _ in range(FLOOD):
        session.put("jetson0/lidar/zones", WALL)
        session.put("jetson0/fusion/verdict", LIE, priority=zenoh.Priority.REAL_TIME)
    for key in ("jetson0/lidar/zones", "jetson0/fusion/verdict", "jetson0/fusion/health", *own):
        for payload in NONSENSE:
            session.put(key, payload)
    for token in others:
        token.undeclare()


def use_spare_time_only() -> None:
    """Leave the processors to the lab's hosts.

    The flood's own work is done on another machine in the field. Here it took the two processors that five hosts share:
    a simulated turn of the pole's lidar then waited up to 0.4 s in the run queue and reached the vehicle too late.
    """
    os.setsid()
    os.nice(19)
    with contextlib.suppress(OSError):  # a kernel without groups by session, where the line above is enough
        Path("/proc/self/autogroup").write_text("19", encoding="ascii")


def main() -> None:
    use_spare_time_only()
    folder, host = Path(sys.argv[1]), sys.argv[2]
    found = doors(folder, load_site(folder / "site.toml")) if host == "laptop1" else {}
    session = session_on(folder, host)
    if host == "laptop1":
        token = session.liveliness().declare_token("pi0/radar/alive/liar")
        for _ in range(FLOOD):
            session.put("pi0/radar/tracks", LIE)
        token.undeclare()
    lie(session, () if host == "laptop1" else ("pi0/radar/tracks",))
    close_session(session)
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
