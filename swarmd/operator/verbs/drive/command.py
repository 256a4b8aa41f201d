"""`swarmctl drive`: drive one robot by the keys of a terminal."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from swarmd.core.errors import RequestError
from swarmd.operator.cli.options import CommonOptions, common_options
from swarmd.operator.cli.output import signals_end, warn
from swarmd.operator.cli.send import asking, report, show
from swarmd.operator.client.stops import stop_names
from swarmd.operator.client.targets import make_targets
from swarmd.operator.session.exit_codes import FAILED, NO_TARGET
from swarmd.operator.verbs.drive.ask import KEY_TIME, Hand, take
from swarmd.operator.verbs.drive.words import HELP, Key, keys_of, line_of, motion_of, speed_after

if TYPE_CHECKING:
    from swarmd.operator.cli.send import Asked

_LOOK = 0.2  # s between two looks at what the robot says
_SPEED = 0.1  # m/s


@click.command()
@click.argument("robot")
@click.option(
    "--speed",
    type=click.FloatRange(0.02, 1.0),
    default=_SPEED,
    show_default=True,
    help="m/s of a key, at the begin; the robot's own limit holds beneath it.",
)
@common_options
def drive(options: CommonOptions, robot: str, speed: float) -> None:
    """Drive ROBOT by hand; a run waits meanwhile, and goes on when you release it (Enter).

    Arrows or w a s d drive for 0.7 s, a key that is held goes on; space stands. Enter releases
    the robot, x stops it with its run, q leaves it: then it stands, and a run of it waits for
    `swarmctl resume`. So it does if this program ends or is not heard. Protection bounds it all.
    """
    if not sys.stdin.isatty():
        raise click.UsageError(
            "drive reads the keys of a terminal, and there is none; a program drives by"
            " `swarm.drive(robot)` in Python"
        )
    with asking(options, make_targets((robot,), (), ()), needs_status=False) as asked:
        if len(asked.names) != 1:
            text = f"drive takes one robot; {robot!r} is {', '.join(asked.names)}"
            raise RequestError(text, NO_TARGET)
        hand = take(
            asked.operator,
            asked.view,
            asked.names[0],
            timeout=asked.targeted.time_left,
            issued=asked.targeted.session.began,
        )
        with signals_end(), hand_let_go(hand):
            last = _by_keys(hand, speed)
        _end(asked, hand, last)


@contextmanager
def hand_let_go(hand: Hand) -> Iterator[None]:
    """Tell nothing after an error or a signal: the robot then stands, and is not released."""
    try:
        yield
    except BaseException:
        hand.close()
        raise


def _by_keys(hand: Hand, speed: float) -> Key | None:
    """Drive until a key ends it, which is returned; None if the hand is over."""
    warn(f"{HELP}")
    shown = ""
    with _single_keys() as descriptor:
        while not hand.is_over:
            line = line_of(hand.robot, hand.status, speed)
            if line != shown:
                shown = line
                click.echo(f"\r\x1b[K{line}", nl=False)
            if not select.select([descriptor], [], [], _LOOK)[0]:
                continue
            data = os.read(descriptor, 1024)
            if not data:
                return Key.LEAVE  # the terminal has gone
            for key in keys_of(data):
                if key in (Key.RELEASE, Key.STOP, Key.LEAVE):
                    return key
                speed = speed_after(key, speed)
                motion = motion_of(key, speed)
                if motion is not None and not hand.is_over:
                    hand.move(*motion, seconds=KEY_TIME)
    return None


def _end(asked: Asked, hand: Hand, last: Key | None) -> None:
    """Release, stop or leave the robot, and say what it does."""
    click.echo("")
    if last is Key.RELEASE:
        outcome = hand.release(timeout=asked.options.timeout)
        show(asked.options, outcome)
        click.get_current_context().exit(outcome.exit_code)
    why = hand.over
    hand.close()
    if last is Key.STOP:
        report(asked.options, stop_names(asked.operator, asked.names))
    if last is Key.LEAVE:
        warn(f"{hand.robot} was left, not released: it stands, and holds a run until `resume`")
        return
    raise RequestError(f"{hand.robot} is no longer driven: {why}", FAILED)


@contextmanager
def _single_keys() -> Iterator[int]:
    """The descriptor of the terminal, which gives single keys without echo meanwhile."""
    descriptor = sys.stdin.fileno()
    before: list[Any] = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        yield descriptor
    finally:
        termios.tcsetattr(descriptor, termios.TCSAFLUSH, before)
