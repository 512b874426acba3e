"""Rows of tables to CSV and Parquet files."""

from __future__ import annotations

import csv
import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from spotter_tools.cli.export_tables import Row
from spotter_tools.cli.fail import needs_extra

PARQUET_ROWS = 50_000  # rows a group: what is kept in memory
BOOLEANS = {
    "confirmed", "suppressed", "blind", "approaching", "moving", "coasting", "in_zone", "truncated", "seen_before",
}  # fmt: skip
UNITS = ("_m", "_mps", "_rad", "_s", "_ms", "_db", "_px")


def write_csv(out: Path, names: list[str], table: Iterable[Row]) -> None:
    """The table with a head of names; what a row does not have stays empty."""
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
        needs_extra(".csv needs nothing, Parquet needs", "parquet")
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
