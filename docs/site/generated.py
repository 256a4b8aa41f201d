"""The directive `reference`: a part of the reference, made when the site is built."""

from __future__ import annotations

from typing import Any

from docutils.nodes import Node
from reference import PARTS
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class Reference(SphinxDirective):
    """Puts the part of the reference that its argument names at this place."""

    required_arguments = 1

    def run(self) -> list[Node]:
        """The nodes of that part."""
        self.env.note_reread()  # what it reads are no pages
        text = "\n\n".join(PARTS[self.arguments[0]]())
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("reference", Reference)
    return {"version": "1", "parallel_read_safe": False}
