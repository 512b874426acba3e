"""`spotter keys init | host | laptop | all | revoke | list | bundle`: the site's authority and its certificates."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from types import ModuleType
from typing import Annotated

import typer

from common.config import ConfigError
from common.host.site import Site
from common.security.names import FILE, read_names
from spotter_tools.cli.connect import AsJson
from spotter_tools.cli.fail import fail
from spotter_tools.cli.site_option import SiteFile, read_site

keys = typer.Typer(help="Certificates of the site: who may connect, and as whom.", no_args_is_help=True)
NameArgument = Annotated[str, typer.Argument(help="A host of site.toml, or a laptop's name.")]
Days = Annotated[int | None, typer.Option("--days", min=1, max=3650, help="Lifetime; host 730, laptop 365.")]


@keys.command()
def init(site_file: SiteFile = None, as_json: AsJson = False) -> None:
    """Make the site's authority. Its key never leaves this machine."""
    site, folder = read_site(site_file)
    authority = _authority()
    try:
        path = authority.init(folder, site.namespace)
    except ConfigError as error:
        fail(str(error))
    _say(as_json, f"{path}: the site's authority; keep {path.with_suffix('.key')} here and safe", file=str(path))


@keys.command()
def host(name: NameArgument, site_file: SiteFile = None, days: Days = None, as_json: AsJson = False) -> None:
    """Issue the certificate of a host in site.toml."""
    site, folder = read_site(site_file)
    try:
        own = site.host(name)
        path = _authority().issue(folder, name, "host", tuple(filter(None, (own.address, own.listen))), days)
    except ConfigError as error:
        fail(str(error))
    _issued(folder, name, path, f"copy it to {name} with `spotter keys bundle {name}`", site, as_json)


@keys.command()
def laptop(name: NameArgument, site_file: SiteFile = None, days: Days = None, as_json: AsJson = False) -> None:
    """Issue a certificate for a laptop: it may listen and ask, and say that it records."""
    site, folder = read_site(site_file)
    if name in site.hosts:
        fail(f"{name!r} is a host of the site; a laptop needs a name of its own")
    try:
        path = _authority().issue(folder, name, "laptop", (), days)
    except ConfigError as error:
        fail(str(error))
    _issued(folder, name, path, f"on the laptop: SPOTTER_CERTIFICATE=keys/{path.name}", site, as_json)


@keys.command("all")
def all_missing(
    laptops: Annotated[list[str] | None, typer.Argument(help="Laptops that shall have a certificate as well.")] = None,
    site_file: SiteFile = None,
    as_json: AsJson = False,
) -> None:
    """Make whatever is missing: the authority, a certificate for each host of the site, and for these laptops."""
    site, folder = read_site(site_file)
    if not (folder / "ca.key").exists():
        init(site_file, as_json)
    for name in site.hosts:
        if not (folder / f"{name}.crt").exists():
            host(name, site_file, None, as_json)
    for name in laptops or []:
        if not (folder / f"{name}.crt").exists():
            laptop(name, site_file, None, as_json)


@keys.command()
def revoke(name: NameArgument, site_file: SiteFile = None, as_json: AsJson = False) -> None:
    """Take a name out of every allow list; a router that sees the new list starts again with it."""
    site, folder = read_site(site_file)
    try:
        gone = _authority().revoke(folder, name)
    except ConfigError as error:
        fail(str(error))
    _say(as_json, f"{gone} is revoked: no router will listen to it any more; {_copy(folder, site)}", revoked=gone)


@keys.command("list")
def list_names(site_file: SiteFile = None, as_json: AsJson = False) -> None:
    """Who has a certificate, until when, and who is revoked."""
    _, folder = read_site(site_file)
    for name, entry in read_names(folder).names.items():
        state = "allowed" if entry.allowed(name) else "revoked"
        common_name, until = entry.common_name(name), str(entry.expires)
        text = f"{name:<16} {entry.kind:<7} {state:<8} CN={common_name:<16} until {until}"
        _say(as_json, text, name=name, kind=entry.kind, state=state, common_name=common_name, expires=until)


@keys.command()
def bundle(
    name: NameArgument,
    site_file: SiteFile = None,
    out: Annotated[Path | None, typer.Option("--out", help="Default NAME.tar here.")] = None,
    as_json: AsJson = False,
) -> None:
    """Pack what one host or laptop needs: site.toml, its key pair, the authority's certificate, the names."""
    site, folder = read_site(site_file)
    target = out or Path(f"{name}.tar")
    wanted = [folder / "ca.crt", folder / FILE, folder / f"{name}.crt", folder / f"{name}.key"]
    missing = [str(path) for path in wanted if not path.exists()]
    if missing:
        fail(f"not there: {', '.join(missing)}; run `spotter keys host {name}` first")
    packed = {f"{site.tls.keys}/{path.name}": path for path in wanted}
    packed |= {"site.toml": site_file} if site_file is not None else {}
    if target.is_dir():
        fail(f"--out {target}: a folder, expected the name of a file")
    try:
        _pack(target, packed)
    except OSError as error:
        fail(f"--out {target}: {error.strerror or error}; nothing was packed")
    _say(as_json, f"{target}: unpack it on {name} in /etc/spotter; it holds a private key", file=str(target))


def _pack(target: Path, packed: dict[str, Path]) -> None:
    """A tar file of these files, by their names in it, for its owner's eyes alone; never half of one.

    Raises:
        OSError: one cannot be read, or the target not written.
    """
    part = target.with_name(f".{target.name}.tmp")
    try:
        part.touch(mode=0o600)
        part.chmod(0o600)
        with tarfile.open(part, "w") as archive:
            for name, path in packed.items():
                archive.add(path, name)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def _authority() -> ModuleType:
    """The module that needs the `keys` extra, which hosts do without."""
    try:
        from common.security import authority
    except ImportError:
        fail('certificates are made where `spotter[keys]` is installed: uv pip install -c constraints.txt ".[keys]"')
    return authority


def _issued(folder: Path, name: str, path: Path, then: str, site: Site, as_json: bool) -> None:
    entry = read_names(folder).names[name]
    common_name, until = entry.common_name(name), str(entry.expires)
    text = f"{path}: CN={common_name}, until {until}; {then}\n{_copy(folder, site)}"
    _say(as_json, text, file=str(path), name=name, common_name=common_name, expires=until)


def _copy(folder: Path, site: Site) -> str:
    """Where routers watch their own copy (spotter_tools/cli/router.py) they restart by themselves."""
    return f"now copy {folder / FILE} to {', '.join(site.hosts)}: each router starts again when it sees it"


def _say(as_json: bool, text: str, **facts: str) -> None:
    print(json.dumps(facts) if as_json else text)
