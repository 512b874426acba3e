"""`spotter export`: a recording as a table, on a map, or as labelled objects for other tools."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from common.geodesy import NO_ORIGIN, MapOrigin
from common.messages import ObjectTracks
from spotter_tools.cli.connect import AsJson
from spotter_tools.cli.export_tables import COLUMNS, Row, columns, rows
from spotter_tools.cli.fail import fail
from spotter_tools.cli.recorded_messages import by_key, messages, one_host, tracks
from spotter_tools.cli.site_option import SiteFile, read_site
from spotter_tools.exports import geojson, kitti, openlabel
from spotter_tools.exports.tables import write_csv, write_parquet

FORMS = ("csv", "parquet", "geojson", "openlabel", "kitti")
TABLES, ON_EARTH = FORMS[:2], FORMS[2:4]


@dataclass(frozen=True)
class Order:
    """What is to be written from which recording, and what was found on the way."""

    file: Path
    tables: tuple[str, ...]
    host: str
    origin: MapOrigin | None
    counts: Counter[str] = field(default_factory=Counter)
    unreadable: Counter[str] = field(default_factory=Counter)


def export(
    file: Annotated[Path, typer.Argument(help="A recording or an incident, MCAP.")],
    out: Annotated[Path, typer.Argument(help="OUT.csv, OUT.parquet (extra `parquet`), OUT.geojson, or any name.")],
    form: Annotated[
        str,
        typer.Option("--as", help=f"{', '.join(FORMS)}; default: as OUT is called. The last three: roadside tracks."),
    ] = "",
    table: Annotated[
        list[str] | None, typer.Option("--table", "-t", help=f"{', '.join(COLUMNS)}; may be repeated. Default: all.")
    ] = None,
    host: Annotated[str, typer.Option("--host", help="Tracks of this roadside host only.")] = "",
    site_file: SiteFile = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite OUT.")] = False,
    as_json: AsJson = False,
) -> None:
    """One row per verdict, track, zone or detection; columns that do not apply to a row are empty.

    Or what the roadside lidars track: GeoJSON (WGS84; the site's [map] says where the map lies), ASAM OpenLABEL 1.0.0,
    or KITTI tracking results.
    """
    chosen = tuple(table or COLUMNS)
    unknown = sorted(set(chosen) - set(COLUMNS))
    if unknown:
        fail(f"--table {', '.join(unknown)}: no such table; known: {', '.join(COLUMNS)}", code=2)
    if out.exists() and file.exists() and out.samefile(file):
        fail(f"{out}: is the recording itself; give another name", code=2)
    if out.exists() and not force:
        fail(f"{out}: is already there; --force overwrites it", code=2)
    form = form or out.suffix[1:]
    if form not in FORMS:
        fail(f"{out}: expected a name that ends with .csv, .parquet or .geojson, or --as {', '.join(FORMS)}", code=2)
    if table and form not in TABLES:
        fail(f"--table {', '.join(chosen)}: {form} holds tracks, no tables", code=2)
    if host and form in TABLES:
        fail(f"--host {host}: {form} holds tables of all hosts; its column `key` begins with the host", code=2)
    order = Order(file, chosen, host, read_site(site_file)[0].map if form in ON_EARTH else None)
    _write_whole(out, form, order)
    if as_json:
        left_out = {"unreadable": dict(order.unreadable)} if order.unreadable else {}
        print(json.dumps({"file": str(out), "rows": dict(order.counts), **left_out}))
    else:
        rows = ", ".join(f"{count} {name}" for name, count in order.counts.items()) or "no rows"
        print(f"{out}: {rows}")
    if order.unreadable:
        left = order.unreadable
        fail(f"{file}: {left.total()} messages could not be read and were left out: {by_key(left)}")


def _write_whole(out: Path, form: str, order: Order) -> None:
    """OUT appears whole or not at all."""
    partial = out.with_name(f".{out.name}.part")
    try:
        _write(partial, form, order)
        partial.replace(out)
    except OSError as error:
        fail(f"{out}: cannot be written: {error.strerror or error}")
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def _write(out: Path, form: str, order: Order) -> None:
    recorded = tracks(order.file, order.unreadable, order.host)
    if form in TABLES:
        write = write_csv if form == "csv" else write_parquet
        write(out, columns(order.tables), _rows(order))
    elif form == "geojson":
        if order.origin is None:
            fail(f"--as geojson: {NO_ORIGIN} (--site FILE)", code=2)
        out.write_text(_text(geojson.ways(recorded, order.origin, order.counts)), encoding="utf-8")
    elif form == "openlabel":
        document = openlabel.annotation(recorded, order.origin, order.file.name, order.counts)
        out.write_text(_text(document), encoding="utf-8")
    else:
        with out.open("w", encoding="ascii") as stream:
            stream.writelines(f"{line}\n" for line in kitti.lines(_of_one_host(recorded), order.counts))


def _of_one_host(recorded: Iterator[tuple[str, ObjectTracks]]) -> Iterator[tuple[str, ObjectTracks]]:
    return one_host(recorded, "a KITTI file holds one sensor's frames")


def _text(document: object) -> str:
    return json.dumps(document, separators=(",", ":"), allow_nan=False) + "\n"


def _rows(order: Order) -> Iterator[Row]:
    for key, message, first_ns in messages(order.file, order.unreadable):
        for row in rows(key, message, first_ns):
            if row["table"] in order.tables:
                order.counts[row["table"]] += 1
                yield row
