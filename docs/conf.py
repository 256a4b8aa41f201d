"""The site of `make docs`: Sphinx reads the Markdown pages of the repository as they are.

The source folder is the root of the repository, so that a link such as ../config/swarm.yaml leads
to the same file on the site as on a forge.
"""

from __future__ import annotations

import re
import sys
from importlib import metadata
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path[:0] = [str(DOCS / "site"), str(ROOT)]

from contents import CONTENTS, INNER  # noqa: E402
from reference import filled  # noqa: E402

project = "swarmd"
author = "the authors of swarmd"
project_copyright = "the authors of swarmd, Apache 2.0"
release = version = metadata.version("swarmd")

root_doc = "docs/README"
include_patterns = ["docs/**.md", "*.md", "benchmarks/README.md", "patterns/**.md", "studies/**.md"]
# Only so that Sphinx does not walk them.
exclude_patterns = [".*", "build", "dist", "runs", "experiments", "*.egg-info"]
exclude_patterns += ["swarmd", "drivers", "sim", "config", "tests"]

extensions = ["myst_parser"]
myst_heading_anchors = 4
myst_enable_extensions = ["html_image"]
highlight_language = "none"
smartquotes = False  # `--all` outside of code would get a dash
html_theme = "furo"
html_title = "swarmd"
html_static_path = ["site/static"]
html_css_files = ["site.css"]
html_search_scorer = str(DOCS / "site" / "scorer.js")
html_copy_source = False
html_show_sphinx = False


def _add_parts(app: Sphinx, page: str, source: list[str]) -> None:
    """Put the parts that are made from the code into the page that names them."""
    source[0] = filled(source[0])


def _add_contents(app: Sphinx, page: str, source: list[str]) -> None:
    """Add the tables of contents of this page, which a forge would show as code."""
    tables = CONTENTS if page == root_doc else {"": INNER[page]} if page in INNER else {}
    for title, pages in tables.items():
        lines = [":hidden:", title and f":caption: {title}", *(f"/{name}" for name in pages)]
        source[0] += "\n".join(["", "```{toctree}", *lines, "```", ""])


def _add_entrance(app: Sphinx, error: Exception | None) -> None:
    """Let index.html lead to the start page."""
    if error is None:
        page = f'<meta http-equiv="refresh" content="0; url={root_doc}.html"><title>swarmd</title>'
        (Path(app.outdir) / "index.html").write_text(f"<!doctype html>{page}\n")


def _check_offline(app: Sphinx, error: Exception | None) -> None:
    """Raise if a page loads something from the network: the site must work without one."""
    remote = re.compile(
        r"""<(?:script|img|iframe|source|video|link\b[^>]*rel="(?:stylesheet|preload|icon)")[^>]*"""
        r"""(?:src|href)="(?:https?:)?//[^"]+|@import[^;]*//|url\(['"]?(?:https?:)?//[^)]+"""
    )
    for file in [*Path(app.outdir).rglob("*.html"), *Path(app.outdir).rglob("*.css")]:
        found = remote.search(file.read_text())
        if found is not None:
            raise ExtensionError(f"{file}: loads from the network: {found[0]}")


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _add_parts)
    app.connect("source-read", _add_contents)
    app.connect("build-finished", _add_entrance)
    app.connect("build-finished", _check_offline)
