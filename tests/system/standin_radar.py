"""A radar by somebody else: Zenoh and msgpack, no line of Spotter's. One target walks up to it from 5 m and away."""

import json
import math
import os
import signal
import threading
import time
import uuid

import msgpack
import zenoh

HOST, SHADOW = os.environ.get("SPOTTER_HOST", "pi0"), os.environ.get("SPOTTER_SHADOW", "")
ME = uuid.uuid4().hex[:8] + (f"-after-{os.environ['SPOTTER_SUCCEEDS']}" if SHADOW else "")
ROUTER = {"endpoints": [os.environ["SPOTTER_CONNECT"]], "timeout_ms": -1}
SITE = os.environ.get("SPOTTER_NAMESPACE", "spotter")
PERIOD_S, SCHEMA = 0.1, "application/msgpack;spotter.{}.v1"
promoted, stopped = threading.Event(), threading.Event()


def tracks(seq, stamp_ns):
    angle = stamp_ns * 1e-9
    track = {"track_id": 1, "range_m": 3.5 + 1.5 * math.cos(angle), "velocity_mps": -1.5 * math.sin(angle)}
    track |= {"azimuth_rad": 0.0, "age_frames": 9, "approaching": False, "moving": True, "ttc_s": None, "snr_db": 20.0}
    whole = {"tracks": [track | {"level": "SAFE"}], "level": "SAFE", "settled": True, "noise_floor_db": -60.0}
    return msgpack.packb({"stamp_ns": stamp_ns, "seq": seq, "frame_id": "radar", "sent_ns": time.time_ns(), **whole})


def about(seq):  # ServiceInfo and ServiceStatus in one: readers ignore fields that they do not know
    who = {"service": "radar", "host": HOST, "instance": ME, "version": "0.1.0", "pid": os.getpid(), "started_ns": 0}
    how = {"state": "online", "reason": "", "published": seq, "dropped": 0, "bad_input": 0, "rate_hz": 1 / PERIOD_S}
    rest = {"topics": [f"{HOST}/radar/tracks"], "config_hash": "", "last_frame_age_s": 0.0, "stage_ms": {}, "rss_mb": 0}
    return msgpack.packb({"stamp_ns": time.time_ns(), "seq": seq, "frame_id": "", **who, **how, **rest})


def announce(session, base):
    def answer(key):
        return session.declare_queryable(key, lambda query: (query.reply(key, about(0)), query.drop()))

    return session.liveliness().declare_token(f"{base}/alive/{ME}"), answer(f"{base}/info"), answer(f"{base}/status")


def main():
    config = {"mode": "client", "connect": ROUTER, "namespace": SITE, "scouting": {"multicast": {"enabled": False}}}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        signal.signal(signal.SIGUSR1, lambda *_: promoted.set())
        signal.signal(signal.SIGTERM, lambda *_: stopped.set())
        base, claims, seq = f"{SHADOW}/{HOST}/radar".lstrip("/"), {}, 0
        while not stopped.wait(PERIOD_S):
            base, seq = f"{HOST}/radar" if promoted.is_set() else base, seq + 1
            session.put(f"{base}/tracks", tracks(seq, time.time_ns()), encoding=SCHEMA.format("RadarTracks"))
            if seq % 10 == 0:
                session.put(f"{base}/status", about(seq), encoding=SCHEMA.format("ServiceStatus"))
            claims[base] = claims.get(base) or announce(session, base)  # data first, then presence


if __name__ == "__main__":
    main()
