# ruff: noqa: C408
"""A radar service by somebody else: no line of Spotter's, only Zenoh and msgpack. It keeps the contract of the wire.

One target walks up to the sensor from 5 m and away again. With ``late`` or ``slow`` it is deliberately worse.
"""

import math
import os
import signal
import sys
import threading
import time
import uuid

import msgpack
import zenoh

HOST = os.environ.get("SPOTTER_HOST", "pi0")
SHADOW, SUCCEEDS = os.environ.get("SPOTTER_SHADOW", ""), os.environ.get("SPOTTER_SUCCEEDS", "")
INSTANCE = uuid.uuid4().hex[:8] + (f"-after-{SUCCEEDS}" if SHADOW else "")
HEADER = {"seq": 0, "frame_id": "radar"}
WORSE = sys.argv[1] if len(sys.argv) > 1 else ""
PERIOD_S = 0.2 if WORSE == "slow" else 0.1
counts = {"published": 0, "seq": 0}
promoted = threading.Event()
signal.signal(signal.SIGUSR1, lambda *_: promoted.set())
signal.signal(signal.SIGTERM, signal.default_int_handler)


def tracks(now_ns):
    range_m = 3.5 + 1.5 * math.cos(now_ns * 1e-9)
    track = dict(
        track_id=1, range_m=range_m, azimuth_rad=0.0, velocity_mps=-1.5 * math.sin(now_ns * 1e-9), age_frames=9
    )
    track |= dict(approaching=False, moving=True, ttc_s=None, level="SAFE", snr_db=20.0)
    return dict(HEADER, stamp_ns=now_ns, tracks=[track], level="SAFE", settled=True, noise_floor_db=-60.0)


def status(now_ns):
    return dict(HEADER, stamp_ns=now_ns, state="online", reason="", published=counts["published"], dropped=0,
                bad_input=0, rate_hz=1 / PERIOD_S, last_frame_age_s=0.0, stage_ms={}, rss_mb=0.0,
                instance=INSTANCE)  # fmt: skip


def info(now_ns):
    return dict(HEADER, stamp_ns=now_ns, service="radar", host=HOST, instance=INSTANCE, version="0.1.0",
                config_hash="none", topics=[f"{HOST}/radar/tracks"], started_ns=now_ns, pid=os.getpid())  # fmt: skip


def put(session, key, schema, message):
    counts["seq"] += 1
    message |= dict(seq=counts["seq"], sent_ns=time.time_ns())
    session.put(key, msgpack.packb(message), encoding=f"application/msgpack;spotter.{schema}.v1")


def announce(session, base):
    def answer(key, make):
        return session.declare_queryable(key, lambda q: (q.reply(key, msgpack.packb(make(time.time_ns()))), q.drop()))

    token = session.liveliness().declare_token(f"{base}/alive/{INSTANCE}")
    return token, answer(f"{base}/info", info), answer(f"{base}/status", status)


def open_when_there(config):
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError:  # no router yet
            time.sleep(0.5)


def main():
    config = zenoh.Config.from_json5('{mode: "client", scouting: {multicast: {enabled: false}}}')
    config.insert_json5("connect/endpoints", '["' + os.environ["SPOTTER_CONNECT"] + '"]')
    config.insert_json5("namespace", '"' + os.environ.get("SPOTTER_NAMESPACE", "spotter") + '"')
    base = f"{SHADOW}/{HOST}/radar" if SHADOW else f"{HOST}/radar"
    with open_when_there(config) as session:
        claims = announce(session, base)
        while True:
            now_ns = time.time_ns()
            live = promoted.is_set() and base != f"{HOST}/radar"
            base = f"{HOST}/radar" if live else base
            time.sleep(0.15 if WORSE == "late" else 0.0)
            put(session, f"{base}/tracks", "RadarTracks", tracks(now_ns))
            counts["published"] += 1
            if live:  # data first, then presence
                claims += announce(session, base)
            if counts["published"] % 10 == 0:
                put(session, f"{base}/status", "ServiceStatus", status(now_ns))
            time.sleep(max(0.0, PERIOD_S - (time.time_ns() - now_ns) * 1e-9))


try:
    main()
except KeyboardInterrupt:
    sys.exit(0)
