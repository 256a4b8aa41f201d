"""Objects that a `with` statement closes."""

from __future__ import annotations

from typing import Self


class Closing:
    """A context manager that is closed at its end."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End what it holds; subclasses say what that is."""
