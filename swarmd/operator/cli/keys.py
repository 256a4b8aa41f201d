"""`swarmctl keys`: the authority of a swarm, and the bundles by which names get their keys."""

from __future__ import annotations

import getpass
import json
import math
import os
import re
import shutil
import socket
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import asdict, replace

from swarmd.core.clock import FIRST_WALL
from swarmd.core.errors import ConfigError
from swarmd.core.keys import check_id
from swarmd.core.names import check_distinct, expand_names, select_names
from swarmd.link.keys.identity import Identity, choose_identity
from swarmd.link.keys.key_permit import check_permit, moment, permit_text
from swarmd.link.keys.roster import PUBLIC_KEY_BYTES, KeyPermit, Role, Roster
from swarmd.operator.cli import keys_rollout
from swarmd.operator.cli.authority_folder import (
    DAYS,
    ask_passphrase,
    authority_folder,
    configuration,
    days_option,
    open_authority,
)
from swarmd.operator.cli.install import report_identity
from swarmd.operator.cli.options import (
    FILE,
    FOLDER,
    PROFILES,
    CommonOptions,
    Duration,
    VerbGroup,
    check_names_or_all,
    common_options,
    local_options,
)
from swarmd.operator.cli.output import print_json, print_table, warn
from swarmd.operator.texts.keys import DAY, UNSET_CLOCK, day, end_of_certificate, life
from swarmd.operator.texts.values import NOTHING

if TYPE_CHECKING:
    from swarmd.link.keys.authority import Authority
    from swarmd.link.keys.bundle import Bundle, OpenedBundle
    from swarmd.link.keys.identity import Identity

DEFAULT_DAYS = 90.0
_swarm_option = click.option("--swarm", metavar="NAME", help="The swarm of the authority.")


@click.group(cls=VerbGroup)
def keys() -> None:
    """Make, hand out, renew and revoke the keys of a swarm.

    One machine keeps the authority: the folder that signs certificates and the roster of names.
    """


@keys.command(epilog="Example: swarmctl keys init meadow --robots 'tb3-[01-07]' --interface wlan0")
@click.argument("swarm")
@click.option("--robots", required=True, metavar="NAMES", help="Such as 'tb3-[01-40]'.")
@click.option("--operators", metavar="NAMES", help="Such as alice,bob [your login name].")
@click.option("--viewers", metavar="NAMES", help="Names that may look and command nothing.")
@click.option(
    "--config",
    type=FILE,
    metavar="FILE",
    help="swarm.yaml with further settings of the swarm, such as labels.",
)
@click.option("--profile", type=PROFILES, help="Of the network.")
@click.option("--interface", metavar="NAME", help="The network interface of robots.")
@click.option("--seed", "seeds", multiple=True, metavar="ENDPOINT", help="A robot to dial.")
@click.option("--router", "routers", multiple=True, metavar="ENDPOINT", help="Of profile routed.")
@click.option("--passphrase", is_flag=True, help="Encrypt the authority with a passphrase.")
@click.option(
    "--days",
    type=DAYS,
    default=DEFAULT_DAYS,
    metavar="N",
    show_default=True,
    help="The life of certificates.",
)
def init(
    swarm: str,
    robots: str,
    operators: str | None,
    viewers: str | None,
    config: Path | None,
    passphrase: bool,
    days: float,
    **settings: Any,
) -> None:
    """Make the authority of SWARM with its roster, and install the first operator here.

    Commas separate the NAMES of an option; a range in brackets is expanded: tb3-[01-40] is tb3-01
    to tb3-40.
    """
    from swarmd.settings.installed import swarm_settings

    check_id(swarm, "the swarm")
    names_by_role = {
        Role.ROBOT: expand_names(robots),
        Role.OPERATOR: expand_names(operators) if operators else (_login_id(),),
        Role.VIEWER: expand_names(viewers) if viewers else (),
    }
    check_distinct(*names_by_role.values())
    # The default profile `dev` stays on this machine, so a network interface means `field`.
    if settings["interface"] and not settings["profile"] and config is None:
        settings["profile"] = "field"
    swarm_yaml = swarm_settings(swarm, config, settings)
    folder = authority_folder(swarm)
    identities = configuration() / "identities" / swarm
    for path in (folder, identities):
        if path.exists():
            raise ConfigError(f"{path} is there already; remove it to begin anew")
    passphrase_bytes = ask_passphrase(is_new=True) if passphrase else None
    authority, installed = _make_authority(
        folder, swarm, names_by_role, swarm_yaml, passphrase_bytes, days
    )
    click.echo(f"authority of swarm {swarm}, certificates of {days:g} days: wrote {folder}")
    report_identity(installed, authority.roster)
    _report_context(swarm)
    option = "" if _is_in_use(swarm) else f" --swarm {swarm}"
    click.echo(
        f"next: swarmctl keys bundle --all -o bundles{option},"
        " then on each robot: swarmd install FILE --platform NAME --driver NAME\n"
        f"keep a copy of {folder}: without it no name can be added, renewed or revoked"
    )


def _make_authority(
    folder: Path,
    swarm: str,
    names_by_role: Mapping[Role, tuple[str, ...]],
    settings: Mapping[str, Any],
    passphrase: bytes | None,
    days: float,
) -> tuple[Authority, Identity]:
    """Write the authority into `folder`, and install the first operator for this user.

    `folder` must not exist. The key, the roster and the `settings` for bundles are written into a
    draft folder, which is renamed to `folder` when all is written. After an error or Ctrl-C neither
    folder is left. `days`: the life of certificates.
    """
    from swarmd.link.keys.authority import Authority
    from swarmd.link.keys.bundle import OpenedBundle
    from swarmd.settings.installed import SWARM_YAML, write_yaml

    draft = folder.with_name(f".{swarm}.partial")
    shutil.rmtree(draft, ignore_errors=True)
    try:
        draft.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        authority = Authority.create(draft, swarm, passphrase, days=days)
        roles = {name: role for role, names in names_by_role.items() for name in names}
        authority.change(add=roles)
        write_yaml(draft / SWARM_YAML, settings, f"Settings of swarm {swarm}, for its bundles.")
        operator_bundle = bundle_of(authority, names_by_role[Role.OPERATOR][0])
        draft.rename(folder)
        opened = OpenedBundle(operator_bundle, authority.roster)
        installed = install_reader(opened, overrides={}, is_forced=False)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return authority, installed


@keys.command(epilog="Example: swarmctl keys bundle --all -o bundles")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--all", "is_all", is_flag=True, help="All names of the roster.")
@click.option(
    "-o",
    "target",
    type=click.Path(path_type=Path),
    metavar="FILE|FOLDER",
    help="Where to [NAME.bundle in this folder].",
)
@days_option
@_swarm_option
def bundle(
    swarm: str | None, names: tuple[str, ...], is_all: bool, target: Path | None, days: float | None
) -> None:
    """Write a bundle for each NAME: one file with its identity and the settings of the swarm.

    NAME may be a range such as 'tb3-[01-40]' or a glob such as 'tb3-*'. A holder of the file has
    the identity: carry the file safely, and remove it once it is installed. The settings are those
    of swarm.yaml in the authority's folder.
    """
    from swarmd.link.keys.bundle import write_bundle

    check_names_or_all("keys bundle", names, is_all)
    authority = open_authority(swarm)
    chosen_names = select_names(names, authority.roster.names)  # all names with --all
    for name, path in _bundle_files(chosen_names, target).items():
        new_bundle = bundle_of(authority, name, days=days)
        write_bundle(path, new_bundle)
        info = new_bundle.info
        click.echo(f"wrote {path}: {info.role} {name}, until {day(info.expires)}")


def _bundle_files(names: Sequence[str], target: Path | None) -> dict[str, Path]:
    """The file to write for each name.

    For a single name: `target` itself, if `target` has a suffix and is no folder. Else a file in
    the folder `target` (None: the present folder), which this function makes.
    """
    from swarmd.link.keys.bundle import SUFFIX

    is_file = target is not None and target.suffix != "" and not target.is_dir()
    if len(names) == 1 and target is not None and is_file:
        return {names[0]: target}
    folder = target or Path()
    folder.mkdir(parents=True, exist_ok=True)
    return {name: folder / f"{name}{SUFFIX}" for name in names}


@keys.command(
    epilog="Example: swarmctl keys issue anna --may stop --may 'run attraction' --robots tb3-01"
)
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@click.option(
    "--may",
    multiple=True,
    required=True,
    metavar="REQUEST",
    help="stop, estop, drive, 'stop ROBOTS', 'estop ROBOTS', 'run PATTERN' or 'param PATTERN.NAME',"
    " with * and ?.",
)
@click.option("--role", metavar="NAME", help="The name of the permit, such as pupils [NAME].")
@click.option("--robots", default="", metavar="ROBOTS", help="Which, such as 'tb3-0[1-3]' [all].")
@click.option("--for", "longest", type=Duration(), help="The longest run, such as 60s.")
@click.option("--speed", type=click.FloatRange(0.0, 100.0, min_open=True), help="At most, in m/s.")
@click.option("--lasts", type=Duration(), help="The life of the permit [that of certificates].")
@click.option(
    "--bundles",
    "target",
    type=click.Path(path_type=Path),
    metavar="FILE|FOLDER",
    help="Where to write the bundles [NAME.bundle in this folder].",
)
@common_options
def issue(
    options: CommonOptions,
    names: tuple[str, ...],
    may: tuple[str, ...],
    role: str | None,
    robots: str,
    longest: float | None,
    speed: float | None,
    lasts: float | None,
    target: Path | None,
) -> None:
    """Give each NAME a permit, write its bundle, and send the new roster to all robots.

    A permit lists what a key may ask; robots refuse everything else, and say what the key may. A
    name with a permit looks as a viewer does. A NAME that has a permit gets this one in its place.
    A robot that takes a new roster stands.
    """
    from swarmd.link.keys.bundle import write_bundle

    authority = open_authority(options.swarm)
    new = [name for word in names for name in expand_names(word)]
    life_of = authority.days * DAY if lasts is None else lasts
    permit = KeyPermit(
        role=check_id(role or new[0], "the name of the permit"),
        key=bytes(PUBLIC_KEY_BYTES),  # `change` sets the key of each name
        may=tuple(" ".join(text.split()) for text in may),
        robots=robots,
        longest=longest,
        speed=speed,
        until=math.ceil(time.time() + life_of),
    )
    check_permit(permit, authority.roster.robots)
    given = {name: replace(permit, role=role or name) for name in new}
    roster = authority.change(permits=given)
    who = ", ".join(new)
    warn(f"generation {roster.generation} of the roster: {who} may {permit_text(permit)}")
    for name, path in _bundle_files(new, target).items():
        write_bundle(path, bundle_of(authority, name))
        click.echo(f"wrote {path}: {name}, until {moment(permit.until)}")
    keys_rollout.roll_out(options, authority)


@keys.command("list", epilog="Example: swarmctl keys list")
@_swarm_option
@local_options
def list_(options: CommonOptions) -> None:
    """List the names of the roster, and how long their newest certificates last.

    GENERATION is the number of the newest roster that a name is known to have. A name has the
    roster of its first bundle, then each roster that was sent and taken. A later bundle does not
    count, since the bundle may not be installed yet.
    """
    authority = open_authority(options.swarm)
    roster = authority.roster
    now = time.time()
    rows: list[dict[str, Any]] = []
    for name in roster.names:
        record = authority.record_of(name)  # None before the first bundle of the name
        days_left = None if record is None else math.floor((record.expires - now) / DAY)
        rows.append(
            {
                "name": name,
                "role": str(roster.role_of(name)),
                "permit": _permit_of(roster, name),
                "is_bundled": record is not None,
                "expires": None if record is None else record.expires,
                "days": days_left,
                "generation": None if record is None else record.generation,
            }
        )
    if options.is_json:
        content = {"swarm": roster.swarm, "generation": roster.generation, "names": rows}
        print_json("Keys", content)
        return
    header = ("NAME", "ROLE", "ENDS", "GENERATION", "BUNDLED")
    print_table(header, [_row(row, now) for row in rows])
    click.echo(f"# swarm {roster.swarm}, roster of generation {roster.generation}")
    for row in rows:
        if row["permit"] is not None:
            click.echo(f"# {row['name']} ({row['permit']['role']}) may {row['permit']['may']}")
    # Notes on certificates that end soon, unless the clock of this machine is not set yet.
    if now < FIRST_WALL:
        click.echo(f"# {UNSET_CLOCK}: whether certificates have ended is not known")
        return
    for row in rows:
        has_end = row["expires"] and row["permit"] is None  # a permit says when it ends
        note = end_of_certificate(row["expires"], now) if has_end else ""
        if note:
            click.echo(f"# {row['name']}: {note}; see `swarmctl keys renew`")


@keys.command(epilog="Example: swarmctl keys install alice.bundle")
@click.argument("file", type=FILE)
@click.option("--interface", metavar="NAME", help="This machine's interface, if it has another.")
@click.option("--force", is_flag=True, help="Replace an identity of another name or authority.")
def install(file: Path, interface: str | None, force: bool) -> None:
    """Take the bundle FILE of an operator or viewer: this user gets that name.

    Writes the identity with the swarm's settings into ~/.config/swarmd/identities, and a context
    named like the swarm (see `swarmctl context`). That context is used if no context is in use.
    """
    from swarmd.link.keys.bundle import read_bundle

    opened = read_bundle(file)
    if opened.bundle.info.role is Role.ROBOT:
        name = opened.bundle.info.name
        raise ConfigError(f"{file} is the bundle of robot {name}; take it there: swarmd install")
    identity = install_reader(opened, {"interface": interface}, is_forced=force)
    report_identity(identity, opened.roster)
    _report_context(identity.info.swarm)


def bundle_of(authority: Authority, name: str, *, days: float | None = None) -> Bundle:
    """A bundle: a new certificate of a name, and the settings in the authority's folder."""
    from swarmd.link.keys.bundle import Bundle, pack_bundle
    from swarmd.settings.installed import SWARM_YAML, checked_settings
    from swarmd.settings.yamlfile import read

    path = authority.folder / SWARM_YAML
    settings = checked_settings(str(path), authority.roster.swarm, read(path))
    made = Bundle(**asdict(authority.issue(name, days=days)), settings=settings)
    pack_bundle(made)  # ConfigError if it is too large
    return made


def install_reader(
    opened: OpenedBundle, overrides: Mapping[str, object], *, is_forced: bool
) -> Identity:
    """Install the identity of an operator or viewer for this user, with settings and a context."""
    from swarmd.link.keys.installation import check_replaces, installed, replaced_identity
    from swarmd.settings.contexts import Context, add_context, context_in_use
    from swarmd.settings.installed import SWARM_YAML, checked_settings, write_yaml

    info = opened.bundle.info
    is_first = context_in_use() is None  # ConfigError before anything is installed
    given = {key: value for key, value in overrides.items() if value}
    settings = checked_settings("the bundle", info.swarm, {**opened.bundle.settings, **given})
    folder = configuration() / "identities" / info.swarm
    check_replaces(opened, installed(folder), is_forced=is_forced)
    with replaced_identity(folder, opened) as identity:
        write_yaml(folder / SWARM_YAML, settings, f"Settings of swarm {info.swarm}.")
    interface = settings.get("interface")
    if interface is not None and interface not in (name for _, name in socket.if_nameindex()):
        warn(f"this machine has no interface {interface}: write its own to {folder / SWARM_YAML}")
    context = Context(swarm=info.swarm, config=str(folder / SWARM_YAML))
    add_context(info.swarm, context, use=is_first)
    return identity


def _permit_of(roster: Roster, name: str) -> dict[str, str] | None:
    """The permit of a name in words; None for a name without one."""
    permit = roster.permits.get(name)
    return None if permit is None else {"role": permit.role, "may": permit_text(permit)}


def _is_in_use(swarm: str) -> bool:
    """True if verbs without options address this swarm."""
    from swarmd.settings.contexts import context_in_use

    name_and_context = context_in_use()
    if name_and_context is None or os.environ.get("SWARM"):
        return False
    _, context = name_and_context
    return context.swarm == swarm


def _report_context(swarm: str) -> None:
    """Print whether swarmctl uses the new context."""
    if _is_in_use(swarm):
        click.echo(f"swarmctl uses context {swarm} from now on; see `swarmctl context list`")
    else:
        click.echo(f"another swarm is in use; change to this one: swarmctl context use {swarm}")


def _row(row: Mapping[str, Any], now: float) -> tuple[str, ...]:
    if not row["is_bundled"]:
        return (row["name"], row["role"], NOTHING, NOTHING, "no")
    left = row["expires"] - now
    ends = life(left) if left > 0.0 else "ended"
    if now < FIRST_WALL:
        ends = day(row["expires"])
    return (row["name"], row["role"], ends, str(row["generation"]), "yes")


def _login_id() -> str:
    """The login name as an id; ConfigError if no part of it is valid."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):
        user = ""
    found = re.sub(r"[^a-z0-9_-]+", "-", user.lower()).strip("-_")[:63]
    if not found:
        raise ConfigError("the login name has no letter for an operator; name one: --operators")
    return found


@click.command(epilog="Example: swarmctl keys router --swarm meadow")
@click.option("--swarm", metavar="NAME", required=True, help="The swarm of the identity.")
@click.option(
    "--identity",
    type=FOLDER,
    metavar="FOLDER",
    help="The router's identity [that of this user or machine for the swarm].",
)
@click.option("--listen", default="tls/[::]:7447", show_default=True, metavar="ENDPOINT")
def router(swarm: str, identity: Path | None, listen: str) -> None:
    """Print the configuration of a Zenoh router (zenohd) with the identity of this machine.

    Give the router a name of its own in the roster, such as the viewer `router`. The configuration
    lists the names of the roster: print it again after `keys add` or `keys revoke`, and restart the
    router.
    """
    found = choose_identity(swarm, identity, insecure=False)
    if found is None:
        raise ConfigError(
            f"no identity of swarm {swarm!r} is here; install a bundle for the router"
        )
    click.echo(json.dumps(router_configuration(found, listen), indent=2))


def router_configuration(identity: Identity, listen: str) -> dict[str, Any]:
    """The configuration of zenohd: TLS links only, and the access rules of each name."""
    from swarmd.link.access import router_access
    from swarmd.link.carriers.session import nested_options, tls_options

    flat = {
        **tls_options(identity),
        "mode": "router",
        "listen/endpoints": [listen],
        "scouting/multicast/enabled": False,
        "access_control": router_access(identity.roster, identity.name),
    }
    return nested_options(flat)


for _verb in (keys_rollout.add, keys_rollout.revoke, keys_rollout.renew, keys_rollout.push, router):
    keys.add_command(_verb)
