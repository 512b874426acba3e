"""`spotter replay --verify`: fusion's verdicts, or a sensor's results, come again exactly as they were recorded."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from spotter_tools.cli.fail import fail
from spotter_tools.cli.progress import Progress
from spotter_tools.cli.recorded_messages import by_key, say_if_cut


def verify_recording(files: list[Path], as_json: bool = False) -> None:
    """Decide every verdict again; exit code 1 with the first difference when the recording does not hold."""
    from common.recording.reader import RecordingError
    from services.jetson.fusion.verify import verify

    _there(files)
    unreadable: Counter[str] = Counter()
    try:
        report = verify(_with_progress(files, unreadable))
    except RecordingError as error:
        fail(str(error))
    if as_json:
        print(json.dumps(vars(report)))
    checked = (
        f"{report.decided_again} of {report.verdicts} verdicts decided again, {report.inputs_checked} inputs checked"
    )
    if report.difference:
        fail(f"{report.difference} ({checked} before that)")
    if unreadable:
        fail(f"{unreadable.total()} messages could not be read: {by_key(unreadable)} ({checked})")
    if not report.decided_again:
        fail("nothing to verify: the recording has no fusion/trace beside its verdicts")
    if not as_json:
        print(f"identical: {checked}")


def verify_services(services: list[str], files: list[Path], config: Path | None, as_json: bool = False) -> None:
    """Run services again over the raw bytes; exit code 1 with the first difference."""
    from common.config import ConfigError
    from common.recording.reader import RecordingError
    from spotter_tools.reprocess import SERVICES, verify_service

    unknown = set(services) - set(SERVICES)
    if unknown:
        fail(f"--service {', '.join(sorted(unknown))}: cannot be run again; known: {', '.join(SERVICES)}", code=2)
    if len(files) != 1:
        fail("--service takes one recording, or the folder that holds its files", code=2)
    _there(files)
    for service in services:
        try:
            outcome = verify_service(service, files[0], config)
        except (ConfigError, RecordingError) as error:
            fail(str(error))
        if as_json:
            print(json.dumps({"service": service, **vars(outcome)}))
        if outcome.difference:
            fail(f"{service}: {outcome.difference} ({outcome.identical} of {outcome.compared} results are identical)")
        if not outcome.compared:
            fail(f"{service}: nothing to verify: no result of it in the recording")
        if not as_json:
            print(f"{service} identical: {outcome.compared} results from raw bytes again")


def _there(files: list[Path]) -> None:
    from common.recording.reader import RecordingError

    for path in files:
        if not path.exists():
            fail(f"{path}: no such file", code=2)
        try:
            say_if_cut(path)
        except RecordingError as error:
            fail(str(error))


def _with_progress(files: list[Path], unreadable: Counter[str]) -> Iterator[tuple[str, bytes]]:
    from common.recording.reader import expected_messages, read

    progress, done, of = Progress(), 0, sum(expected_messages(path) for path in files)
    for path in files:
        for one in read(path, refused=unreadable):
            done += 1
            progress.share(done, of)
            yield one.key, one.payload
    progress.close()
