"""What a node may not do in a pattern, each with one line that names it and says what to do."""

from __future__ import annotations

from swarmd.core.errors import PluginError


class NotCarriedOver(PluginError):
    """A node has used a part of ROS 2, or of Python, that no pattern has."""


class Spun(BaseException):
    """Leaves the `main()` of a script where it spins: from then on the pattern calls the node.

    No Exception, so that the `except Exception` of a script does not catch it.
    """


class Ended(Exception):
    """A node has ended itself, by `rclpy.shutdown()`, `sys.exit()` or a KeyboardInterrupt."""


class Interrupted(KeyboardInterrupt):
    """What nodes know as `KeyboardInterrupt`.

    A node that raises it ends its run, and not the program around it. A node that catches it
    does not catch the interrupt of a user who ends the program.
    """


def one_line(text: str) -> str:
    """A text as a line of a log shows it: line ends and other control characters are spelled out.

    Names of files, and errors of nodes, may have any character.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)
