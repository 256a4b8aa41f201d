"""Objects that a `with` statement closes, and whether the program has ended."""

from __future__ import annotations

import threading
from typing import Self


class Closing:
    """A context manager that is closed at its end."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End what it holds; subclasses say what that is."""


def is_program_on() -> bool:
    """Whether the program goes on, see `is_program_ended`."""
    return not is_program_ended()


def is_program_ended() -> bool:
    """Whether the main thread has ended, or waits for the threads of pools that are left.

    Python joins the threads of `ThreadPoolExecutor` before the main thread counts as ended. The
    module `threading` notes the begin of this wait in `_SHUTTING_DOWN` (Python 3.9 to 3.14); in a
    Python without it only the end of the main thread counts.
    """
    return getattr(threading, "_SHUTTING_DOWN", False) or not threading.main_thread().is_alive()
