"""The whole demo recorded at full rates: size, the recorder's CPU share, what was lost; then held against the rules.

    python -m benchmarks.system.recording                  # half a minute of recording
    python -m benchmarks.system.recording --minutes 10

Every topic, pictures and clouds and Foxglove's schemas too. `replay --verify` has to find every verdict identical, and
one changed verdict in a copy has to be found. Another recorder is killed without warning: how much of the end is lost.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from mcap.reader import make_reader

from common.clock import utc_ns
from common.codec import decode, encode
from common.messages import Verdict
from common.recording.file import RecordingFile
from common.recording.reader import read, summarise
from common.topics import FUSION_VERDICT, find_topic
from spotter_tools.ports import free_port

BINARIES = Path(sys.executable).parent
MINUTES = 0.5
KILLS = 3
KILL_AFTER_S = 4.0
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Print the figures of one recording, of its verification, of a changed copy and of killed recorders."""
    minutes = float(sys.argv[sys.argv.index("--minutes") + 1]) if "--minutes" in sys.argv else MINUTES
    with tempfile.TemporaryDirectory() as name, demo() as endpoint:
        folder = Path(name)
        recording = record(folder / "whole", endpoint, minutes * 60)
        lost_s = [killed(folder / f"killed-{i}", endpoint) for i in range(KILLS)]
        print(f"kill -9: the last message is from {', '.join(f'{s:.2f}' for s in lost_s)} s before the kill")
        print_verify("as recorded", recording)
        print_verify("one verdict changed", changed(recording, folder / "changed.mcap"))


def record(folder: Path, endpoint: str, seconds: float) -> Path:
    """Record so long and print what it took; returns the file."""
    with recorder(folder, endpoint) as process:
        begun_s, begun_cpu_s = time.monotonic(), cpu_s(process.pid)
        threading.Event().wait(seconds)
        share = (cpu_s(process.pid) - begun_cpu_s) / (time.monotonic() - begun_s)
        process.send_signal(signal.SIGINT)
        counted = json.loads(process.communicate(timeout=60)[0])
    path = Path(counted["file"])
    summary = summarise(path)
    rates = Counter({key.partition("/")[2]: count / summary.duration_s for key, count in summary.counts.items()})
    lost = ", ".join(f"{key} {count}" for key, count in dropped_by_key(path).items())
    print(f"{summary.duration_s:.0f} s, {counted['messages']} messages, dropped {counted['dropped']} {lost}")
    print(
        "a second: " + ", ".join(f"{name} {rate:.1f}" for name, rate in sorted(rates.items()) if "status" not in name)
    )
    size_mb, payload_mb = path.stat().st_size / 1e6, counted["bytes"] / 1e6
    print(
        f"{size_mb:.0f} MB on disk ({60 * size_mb / summary.duration_s:.0f} MB a minute), payload {payload_mb:.0f} MB"
    )
    print(f"recorder's CPU share {share:.1%} of one core, load of the machine {os.getloadavg()[0]:.1f}")
    return path


def dropped_by_key(path: Path) -> dict[str, int]:
    """The recorder's own count inside the file, by topic."""
    with path.open("rb") as stream:
        last = [message.data for _, _, message in make_reader(stream).iter_messages(topics=["/recorder/status"])][-1]
    counts: dict[str, int] = json.loads(last)["dropped_by_key"]
    return counts


def killed(folder: Path, endpoint: str) -> float:
    """Seconds between a kill -9 and the last message that the file still holds."""
    with recorder(folder, endpoint) as process:
        threading.Event().wait(KILL_AFTER_S)
        killed_ns = utc_ns()
        process.kill()
        process.wait(10)
    (path,) = folder.glob("*.mcap")
    return (killed_ns - summarise(path).end_ns) / 1e9


def changed(recording: Path, target: Path) -> Path:
    """A copy, pictures and clouds left out, in which the verdict in the middle says something else."""
    counts = summarise(recording).counts
    left = sum(count for key, count in counts.items() if key.endswith(FUSION_VERDICT.name)) // 2
    with RecordingFile(target, {}) as file:
        for one in read(recording):
            topic = find_topic(one.key)
            if topic is None or topic.is_large:
                continue
            message, payload = decode(one.payload, topic.message, topic.max_bytes), one.payload
            if isinstance(message, Verdict):
                left -= 1
                if left == 0:
                    message = msgspec.structs.replace(message, level="SAFE" if message.level != "SAFE" else "CAUTION")
                    payload = encode(message)
            file.add(one.key, topic.message, payload, one.log_ns, message.sent_ns, message.seq)
    return target


def print_verify(title: str, path: Path) -> None:
    """What `spotter replay --verify` says of a file, and how long it took."""
    begun_s = time.monotonic()
    command = [str(BINARIES / "spotter"), "replay", "--verify", str(path)]
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    said = (finished.stdout + finished.stderr).strip()
    print(f"{title}: exit code {finished.returncode} in {time.monotonic() - begun_s:.0f} s: {said[:300]}")


@contextmanager
def demo() -> Iterator[str]:
    """The demo until the block ends; gives its router's endpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [str(BINARIES / "spotter"), "demo", "--listen", endpoint, "--port", str(free_port())]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        if not any(b"Spotter is up" in line for line in process.stderr):
            raise SystemExit("the demo ended before it was up")
        threading.Thread(target=process.stderr.read, daemon=True).start()
        try:
            yield endpoint
        finally:
            process.send_signal(signal.SIGINT)


@contextmanager
def recorder(folder: Path, endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    """`spotter record` of everything, from the moment at which its file is there."""
    folder.mkdir()
    command = [str(BINARIES / "spotter"), "record", str(folder), "--large", "--json", "--rotate-mb", "1000000"]
    with subprocess.Popen([*command, "--connect", endpoint], stdout=subprocess.PIPE) as process:
        pause = threading.Event()
        while not any(path.stat().st_size > 10_000 for path in folder.glob("*.mcap")):
            pause.wait(0.05)
            if process.poll() is not None:
                raise SystemExit("the recorder ended")
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def cpu_s(pid: int) -> float:
    """User and system time of a process with all its threads, seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


if __name__ == "__main__":
    main()
