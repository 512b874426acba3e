"""`spotter export`: a recording as a table for a spreadsheet or a data frame."""

from __future__ import annotations

import csv
import importlib
import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from common.cli.connect import AsJson
from common.cli.fail import fail
from common.cli.progress import Progress
from common.cli.tables import COLUMNS, Row, columns, rows
from common.codec import DecodeError, decode
from common.topics import find_topic

PARQUET_ROWS = 50_000  # rows a group: what is kept in memory


def export(
    file: Annotated[Path, typer.Argument(help="A recording or an incident, MCAP.")],
    out: Annotated[Path, typer.Argument(help="OUT.csv, or OUT.parquet (extra `parquet`).")],
    table: Annotated[
        list[str] | None, typer.Option("--table", "-t", help=f"{', '.join(COLUMNS)}; may be repeated. Default: all.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite OUT.")] = False,
    as_json: AsJson = False,
) -> None:
    """One row per verdict, track, zone or detection; columns that do not apply to a row are empty."""
    chosen = tuple(table or COLUMNS)
    unknown = sorted(set(chosen) - set(COLUMNS))
    if unknown:
        fail(f"--table {', '.join(unknown)}: no such table; known: {', '.join(COLUMNS)}", code=2)
    if out.exists() and not force:
        fail(f"{out}: is already there; --force overwrites it", code=2)
    write = {".csv": write_csv, ".parquet": write_parquet}.get(out.suffix)
    if write is None:
        fail(f"{out}: expected a name that ends with .csv or .parquet", code=2)
    counts: Counter[str] = Counter()
    partial = out.with_name(f".{out.name}.part")  # OUT appears whole or not at all
    try:
        write(partial, columns(chosen), _counted(_rows(file, chosen), counts))
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
    if as_json:
        print(json.dumps({"file": str(out), "rows": dict(counts)}))
    else:
        told = ", ".join(f"{count} {name}" for name, count in counts.items()) or "no rows"
        print(f"{out}: {told}")


def _counted(table: Iterator[Row], counts: Counter[str]) -> Iterator[Row]:
    for row in table:
        counts[row["table"]] += 1
        yield row


def _rows(file: Path, chosen: tuple[str, ...]) -> Iterator[Row]:
    try:
        from common.recording.reader import RecordingError, expected_messages, read
    except ImportError as error:
        fail(f"exporting needs the extra `laptop`: {error}")
    if not file.is_file():
        fail(f"{file}: no such file", code=2)
    progress, first_ns, undecodable = Progress(), 0, 0
    try:
        of = expected_messages(file)
        for done, recorded in enumerate(read(file)):
            first_ns = first_ns or recorded.log_ns
            progress.share(done, of, f"{(recorded.log_ns - first_ns) / 1e9:.0f} s")
            topic = find_topic(recorded.key)
            if topic is None:
                continue
            try:
                message = decode(recorded.payload, topic.message, topic.max_bytes)
            except DecodeError:
                undecodable += 1
                continue
            yield from (row for row in rows(recorded.key, message, first_ns) if row["table"] in chosen)
    except RecordingError as error:
        fail(str(error))
    finally:
        progress.close()
    if undecodable:
        sys.stderr.write(f"spotter: {undecodable} messages could not be decoded and were left out\n")


def write_csv(out: Path, names: list[str], table: Iterable[Row]) -> None:
    with out.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, names, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


def write_parquet(out: Path, names: list[str], table: Iterable[Row]) -> None:
    """In groups of rows, with the types of ``_parquet_type``."""
    try:
        arrow: Any = importlib.import_module("pyarrow")
        parquet: Any = importlib.import_module("pyarrow.parquet")
    except ImportError:
        fail("Parquet needs the extra `parquet`; .csv does not")
    schema = arrow.schema([(name, _parquet_type(arrow, name)) for name in names])
    with parquet.ParquetWriter(out, schema) as writer:
        group: list[Row] = []
        for row in table:
            group.append(row)
            if len(group) >= PARQUET_ROWS:
                writer.write_table(arrow.Table.from_pylist(group, schema=schema))
                group = []
        writer.write_table(arrow.Table.from_pylist(group, schema=schema))


def _parquet_type(arrow: Any, name: str) -> Any:
    """By name, so that a column has the same type in every recording."""
    if name in ("stamp_ns", "seq", "track_id", "points", "age_frames"):
        return arrow.int64()
    if name.endswith("_used") or name in BOOLEANS:
        return arrow.bool_()
    if name.endswith(UNITS) or name in ("label_confidence", "confidence", "score"):
        return arrow.float64()
    return arrow.string()


BOOLEANS = {"confirmed", "suppressed", "blind", "approaching", "moving", "coasting", "in_zone", "truncated"}
UNITS = ("_m", "_mps", "_rad", "_s", "_ms", "_db", "_px")
