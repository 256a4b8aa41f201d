"""Changes of labels."""

from __future__ import annotations

import pytest

from swarmd.core.errors import ConfigError
from swarmd.operator.verbs.label.words import changed, read_changes


def test_signs_add_and_remove() -> None:
    assert read_changes(["+red", "-blue", "+fast"]) == (("red", "fast"), ("blue",))
    assert changed(("blue", "old"), ("red", "old"), ("blue",)) == ("old", "red")


@pytest.mark.parametrize("words", [[], ["red"], ["+Red"], ["+"], ["+red", "-red"]])
def test_other_words_are_refused(words: list[str]) -> None:
    with pytest.raises(ConfigError):
        read_changes(words)
