"""``--site FILE``: how a command finds the site; SPOTTER_SITE works as well."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from common.config import ConfigError
from common.host.site import Site, keys_folder, load_site
from spotter_tools.cli.fail import fail

SiteFile = Annotated[
    Path | None,
    typer.Option("--site", envvar="SPOTTER_SITE", help="site.toml; without it the whole site is this machine."),
]


def read_site(path: Path | None) -> tuple[Site, Path]:
    """The site and its folder of keys; ends the program with exit code 2 when the file is wrong."""
    try:
        site = load_site(path)
    except ConfigError as error:
        fail(str(error), code=2)
    return site, keys_folder(site, path)
