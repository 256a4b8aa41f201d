"""`swarmctl keys add|revoke|renew|push`: changes of the roster, and how they get to the robots."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from string import digits
from types import MappingProxyType
from typing import TYPE_CHECKING, NoReturn

import click

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.messages import Reply
from swarmd.core.names import expand_names, select_names
from swarmd.core.verbs import RosterRequest
from swarmd.link.keys.identity import RosterFile, as_of, find_identity, load_identity, write_roster
from swarmd.link.keys.roster import Role
from swarmd.link.keys.roster_change import take_certificate
from swarmd.operator.cli.authority_folder import configuration, days_option, open_authority
from swarmd.operator.cli.options import CommonOptions, Failure, check_names_or_all, common_options
from swarmd.operator.cli.output import warn
from swarmd.operator.cli.send import report, session_of
from swarmd.operator.session.exit_codes import NO_TARGET
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.texts.keys import day

if TYPE_CHECKING:
    from swarmd.link.keys.authority import Authority
    from swarmd.link.keys.identity import Identity, Issued
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator

MAX_CERTIFICATES = 32
"""New certificates in one request."""
ANSWER_TIME = 3.0
"""How long a revoked robot may take to answer, in s."""


@click.command(epilog="Example: swarmctl keys add tb3-41")
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@click.option(
    "--role",
    type=click.Choice([str(role) for role in Role if role is not Role.PERMIT]),
    help="What they may do in the swarm [robot, for names that are numbered as its robots].",
)
@common_options
def add(options: CommonOptions, names: tuple[str, ...], role: str | None) -> None:
    """Add each NAME, or range such as 'tb3-[41-50]', and send the new roster to all robots.

    A robot that takes a new roster stands. Write the bundles of the new names with `keys bundle`.
    A name that may do less than an operator gets a permit: `keys issue`.
    """
    authority = open_authority(options.swarm)
    new = [name for word in names for name in expand_names(word)]
    given = _role_by_name(new, authority.roster.robots) if role is None else Role(role)
    authority.change(add=dict.fromkeys(new, given))
    _announce(authority, f"added {', '.join(new)} ({given})")
    warn(f"next: swarmctl keys bundle {' '.join(names)}")
    roll_out(options, authority)


def _role_by_name(names: Iterable[str], robots: Iterable[str]) -> Role:
    """The role `robot` if each name is that of a robot with another number at its end.

    ConfigError else: who commands is never guessed.
    """
    series = {name.rstrip(digits) for name in robots if name[-1:] in digits}
    for name in names:
        if name[-1:] not in digits or name.rstrip(digits) not in series:
            raise ConfigError(
                f"{name} is not numbered as a robot of the roster; give --role robot, operator or"
                " viewer"
            )
    return Role.ROBOT


@click.command(epilog="Example: swarmctl keys revoke tb3-07")
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@common_options
def revoke(options: CommonOptions, names: tuple[str, ...]) -> None:
    """Take each NAME from the roster, and send the roster to all robots: they refuse that name.

    A robot that takes a new roster stands. A robot that is out of reach still trusts the name,
    until the robot gets the new roster from another robot or by `keys push`. The name cannot be
    added again before its last certificate ends. A revoked robot answers nothing: get its
    recordings, log and audit log first (`record fetch`, `logs`, `audit`).
    """
    authority = open_authority(options.swarm)
    roster = authority.roster
    gone = select_names(names, roster.names)
    if not roster.operators.keys() - set(gone) or not set(roster.robots) - set(gone):
        raise ConfigError("a swarm needs a robot and an operator; add another one first")
    own = find_identity(roster.swarm)
    if own is not None and own.info.authority == authority.public_key and own.name in gone:
        raise ConfigError(
            f"{own.name} is this user, who could roll out no further roster from here; take the"
            " bundle of another operator first (`swarmctl keys install --force`)"
        )
    authority.change(remove=gone)
    _announce(authority, f"revoked {', '.join(gone)}")
    roll_out(options, authority, revoked=tuple(name for name in gone if name in roster.robots))


@click.command(epilog="Example: swarmctl keys renew --all")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--all", "is_all", is_flag=True, help="All robots, and this operator.")
@days_option
@common_options
def renew(options: CommonOptions, names: tuple[str, ...], is_all: bool, days: float | None) -> None:
    """Give robots, and this operator, new certificates for the keys that they have.

    Each robot that takes a new certificate stands. Other operators and viewers need a new bundle:
    `keys bundle`.
    """
    check_names_or_all("keys renew", names, is_all)
    authority = open_authority(options.swarm)
    settings, own_identity = _network(options, authority)
    chosen = _renewable(authority, own_identity, names)
    robots = tuple(name for name in chosen if name in authority.roster.robots)
    if own_identity.name in chosen:
        _renew_own(authority, own_identity, days)
    if not robots:
        return
    # `is_recorded` False: only a certificate that its robot takes is recorded, below.
    issued = {name: authority.issue(name, days=days, is_recorded=False) for name in robots}
    outcome = _send_roster(options, settings, own_identity, authority, robots, issued=issued)
    for name in outcome.applied:
        authority.note_issued(issued[name])
    if outcome.missing:
        warn("robots that were not reached keep their certificates: repeat `swarmctl keys renew`")
    _finish(options, authority, own_identity, outcome)


def _renewable(authority: Authority, own: Identity, names: tuple[str, ...]) -> list[str]:
    """The chosen names that have keys; without `names`: all robots, and this operator (`own`).

    ConfigError for another operator or a viewer, whom the network does not reach.
    """
    roster = authority.roster
    chosen = select_names(names, roster.names) if names else (*roster.robots, own.name)
    with_keys = [name for name in chosen if authority.record_of(name) is not None]
    need_bundle = [name for name in with_keys if name not in roster.robots and name != own.name]
    if need_bundle:
        raise ConfigError(f"{', '.join(need_bundle)}: only a bundle brings them a new certificate")
    return with_keys


@click.command(epilog="Example: swarmctl keys push")
@common_options
def push(options: CommonOptions) -> None:
    """Roll the present roster out to the robots that may not have it yet."""
    authority = open_authority(options.swarm)
    if not _outstanding(authority):
        click.echo(f"all robots have generation {authority.roster.generation} of the roster")
        return
    roll_out(options, authority)


def roll_out(
    options: CommonOptions, authority: Authority, revoked: tuple[str, ...] = ()
) -> NoReturn:
    """Send the roster to all robots that may lack it, report, and end with the exit code.

    Robots without a bundle are left out, since they have no keys yet. A revoked robot in reach gets
    the roster, and stands. The new secret, from which the members of the swarm derive the keys of
    their datagrams, goes to no revoked robot.
    """
    settings, own = _network(options, authority)
    wanted = _outstanding(authority)
    if not wanted:
        text = "no robot has a bundle of this swarm yet: nothing was rolled out"
        raise Failure(text, NO_TARGET)
    try:
        outcome = _send_roster(options, settings, own, authority, wanted, revoked=revoked)
    except SwarmError:
        warn("the roster is not rolled out; repeat it with `swarmctl keys push`")
        raise
    if outcome.missing:
        warn("robots that were not reached take the roster from others, or by `swarmctl keys push`")
    _finish(options, authority, own, outcome)


def _announce(authority: Authority, what: str) -> None:
    warn(f"{what}: generation {authority.roster.generation} of the roster")


def _outstanding(authority: Authority) -> tuple[str, ...]:
    """The robots that have a bundle, and may not have the present generation of the roster."""
    records = ((name, authority.record_of(name)) for name in authority.roster.robots)
    generation = authority.roster.generation
    return tuple(name for name, record in records if record and record.generation < generation)


def _network(options: CommonOptions, authority: Authority) -> tuple[NetworkSettings, Identity]:
    """The network of the authority's swarm, and this user's identity of an operator in it."""
    from swarmd.settings.installed import SWARM_YAML

    swarm = authority.roster.swarm
    installed = configuration() / "identities" / swarm / SWARM_YAML
    config = options.in_context().config or (installed if installed.exists() else None)
    settings, _, identity = replace(options, swarm=swarm, config=config).network()
    if identity is None or identity.info.authority != authority.public_key:
        raise Failure(
            f"this user has no identity of this authority of swarm {swarm}; take the bundle of an"
            " operator (`swarmctl keys install`), then `swarmctl keys push`",
            NO_TARGET,
        )
    if authority.roster.role_of(identity.name) is not Role.OPERATOR:
        raise Failure(
            f"{identity.name} (this user) is no operator on generation"
            f" {authority.roster.generation} of the roster, so that robots refuse its requests;"
            " nothing was sent; install the bundle of an operator (`swarmctl keys bundle`,"
            " `swarmctl keys install --force`), then `swarmctl keys push`",
            NO_TARGET,
        )
    return settings, identity


def _send_roster(
    options: CommonOptions,
    settings: NetworkSettings,
    own: Identity,
    authority: Authority,
    robots: tuple[str, ...],
    *,
    issued: Mapping[str, Issued] = MappingProxyType({}),
    revoked: tuple[str, ...] = (),
) -> Outcome:
    """Send the present roster, and new certificates if any, to `robots`; returns all replies.

    `own`: the identity of this operator. `issued`: the new certificate by robot, or empty.
    `revoked`: robots that were taken from the roster; those in reach get the roster without the new
    secret of the swarm, from which its members derive keys.

    A robot only accepts datagrams that are signed with the keys of its own generation (version) of
    the roster. Robots may have different generations, so the operator sends to the robots of one
    generation after the other, each time with the keys of that generation.
    """
    from swarmd.operator.session.operator import Operator

    replies: dict[str, Reply] = {}
    seconds = 0.0  # the duration of all queries and requests
    for identity in _identities(own, authority, robots):
        generation = identity.roster.generation
        # A robot never has an earlier generation than the authority has recorded for it.
        candidates = [name for name in robots if _generation(authority, name) <= generation]
        remaining = [name for name in candidates if name not in replies]
        if not remaining:
            continue
        # `takes_rosters` False: the operator keeps the keys of `generation` in this block.
        with Operator(settings, identity=identity, takes_rosters=False) as operator:
            # Half of the time is left for the requests.
            query_timeout = None if options.timeout is None else options.timeout / 2.0
            view = operator.members(timeout=query_timeout, needs_status=False)
            outcomes = _send_in_batches(options, operator, view, authority, remaining, issued)
            # Revoked robots get the roster once, with the keys that this operator has had so far.
            # No revoked robot has newer keys; a revoked robot with older keys is not reached.
            is_own_generation = generation == own.roster.generation
            if revoked and is_own_generation:
                _send_to_revoked(operator, view, authority, revoked)
        seconds += view.seconds
        for outcome in outcomes:
            replies |= outcome.replies
            seconds += outcome.seconds
    missing = tuple(sorted(set(robots) - replies.keys()))
    return Outcome(replies=replies, missing=missing, seconds=seconds)


def _send_in_batches(
    options: CommonOptions,
    operator: Operator,
    view: MembersView,
    authority: Authority,
    robots: list[str],
    issued: Mapping[str, Issued],
) -> list[Outcome]:
    """Send the roster to `robots`, in requests with at most MAX_CERTIFICATES certificates each.

    `view`: the result of a query; a robot that has changed since this query refuses its request.
    `issued`: the new certificate of each robot; empty to send the roster alone, in one request.
    """
    batch_size = MAX_CERTIFICATES if issued else len(robots)
    outcomes = []
    for start in range(0, len(robots), batch_size):
        batch = robots[start : start + batch_size]
        certificates = {name: issued[name].certificate for name in batch} if issued else {}
        outcomes.append(
            operator.request(
                RosterRequest,
                view.epochs(batch),
                timeout=session_of(options, operator).time_left(view),
                roster=authority.signed_roster,
                secret=authority.secret,
                certificates=certificates,
            )
        )
    return outcomes


def _identities(own: Identity, authority: Authority, robots: Iterable[str]) -> Iterator[Identity]:
    """Yields this user's identity with the keys of each generation that a robot may have.

    A generation is a version of the roster. A datagram is signed with the keys of one generation,
    and a robot accepts only its own generation. The generations are those that the authority has
    recorded for `robots`, and the present generation. A robot may have the present generation
    without a record: the robot's answer was lost, or the robot has a new bundle.
    """
    present = authority.roster_of(own.name, own.roster.generation)
    yield own if present is None else as_of(own, present)
    generations = {_generation(authority, name) for name in robots}
    generations.add(authority.roster.generation)
    for generation in sorted(generations - {own.roster.generation}, reverse=True):
        file = authority.roster_of(own.name, generation)
        if file is not None:
            yield as_of(own, file)


def _generation(authority: Authority, name: str) -> int:
    record = authority.record_of(name)
    return 0 if record is None else record.generation


def _send_to_revoked(
    operator: Operator, view: MembersView, authority: Authority, revoked: tuple[str, ...]
) -> None:
    """Send the roster, without the new secret, to revoked robots that are in reach."""
    reached = [name for name in revoked if view.is_in_reach(name)]
    outcome = operator.request(
        RosterRequest, view.epochs(reached), timeout=ANSWER_TIME, roster=authority.signed_roster
    )
    for name in revoked:
        if name in outcome.applied:
            warn(f"{name} stands, and refuses runs")
        else:
            warn(f"{name} was not reached: it may run on, and all that have the roster ignore it")


def _finish(
    options: CommonOptions, authority: Authority, own: Identity, outcome: Outcome
) -> NoReturn:
    """Store what the robots have now, take the roster for this operator, and report."""
    taken = list(outcome.applied)
    own = load_identity(own.folder)  # another command may have written a newer one meanwhile
    is_newer = own.roster.generation < authority.roster.generation
    if taken and is_newer and authority.roster.role_of(own.name) is not None:
        file = RosterFile(authority.signed_roster, authority.keys_of(own.name))
        write_roster(own.folder, file)
        taken.append(own.name)
    authority.note_taken(taken)
    report(options, outcome)


def _renew_own(authority: Authority, own: Identity, days: float | None) -> None:
    issued = authority.issue(own.name, days=days, is_recorded=False)
    renewed = take_certificate(own, issued.certificate)
    if renewed is None:
        raise ConfigError(f"{own.name} has a certificate that ends later; give more --days")
    authority.note_issued(issued)
    click.echo(f"{own.name}: until {day(renewed.info.expires)}")
