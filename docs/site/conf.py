"""Sphinx: the pages of the checkout as they are, and the reference from the docstrings. Run by scripts/docs."""

from __future__ import annotations

import hashlib
import re
import shutil
import sys
import tomllib
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))  # Sphinx reads this file alone

from docstrings import as_restructured_text

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project, version, release = "Aritra", PROJECT["version"], PROJECT["version"]
author = PROJECT["authors"][0]["name"]
project_copyright = f"2026 {author}"

root_doc = "README"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
include_patterns = ["*.md", "docs/**.md", "api/*.rst", "tests/hidden/README.md"]
autodoc_default_options = {"members": True, "undoc-members": True, "member-order": "bysource", "show-inheritance": True}
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
myst_heading_anchors = 4
highlight_language = "text"

html_theme = "furo"
html_title = f"Aritra {version}"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}

_DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", re.M | re.S)
GROUPS = {
    "On the boat": "service container run-file vessel-file autopilot check ground-station modes trust sitl",
    "On shore": "shore telemetry",
    "Logs": "logs run-format",
    "Models": "commission excite identify wiring diagnose watch campaign simulate method cse1 paper bench",
    "Inside": "architecture glossary adding",
}
"""Caption in the sidebar -> pages of docs/; others stand under "More"."""


def sidebar(source: Path) -> str:
    """The tables of contents that stand, unseen, at the end of the first page."""
    placed = {name for names in GROUPS.values() for name in names.split()}
    others = [path.stem for path in sorted((source / "docs").glob("*.md")) if path.stem not in placed]
    trees = {caption: [f"docs/{name}" for name in names.split()] for caption, names in GROUPS.items()}
    trees["Inside"] += ["CONTRIBUTING", "SECURITY", "CHANGELOG"]
    trees["More"] = [*(f"docs/{name}" for name in others), "tests/hidden/README"]
    for caption, pattern in {
        "Benchmarks": "docs/benchmarks/*.md",
        "Decisions": "docs/adr/*.md",
        "Reference": "api/*",
    }.items():
        trees[caption] = [str(path.relative_to(source).with_suffix("")) for path in sorted(source.glob(pattern))]
    blocks = [
        f"```{{toctree}}\n:hidden:\n:caption: {name}\n\n" + "\n".join(pages) for name, pages in trees.items() if pages
    ]
    return "".join(f"\n\n{block}\n```\n" for block in blocks)


def page_read(app: Sphinx, name: str, text: list[str]) -> None:
    """Add the sidebar to the first page; put drawn diagrams in place of their sources."""
    text[0] = _DIAGRAM.sub(_picture, text[0])
    if name == root_doc:
        text[0] += sidebar(Path(app.srcdir))


def _picture(fence: re.Match[str]) -> str:
    """The picture that scripts/diagrams drew of this source; where there is none, the build fails."""
    return f"![diagram](/docs/figures/diagram-{hashlib.sha256(fence[1].encode()).hexdigest()[:8]}.svg)"


def link_to_files(app: Sphinx, tree: nodes.document) -> None:
    """Links to files of the project lead to a copy: as text, which a browser shows, but for notebooks."""
    page = Path(app.env.docname)
    up = "../" * (len(page.parts) - 1)
    for link in list(tree.findall(addnodes.download_reference)):
        file = (Path(app.srcdir) / page.parent / link["reftarget"]).resolve()
        as_text = "" if file.suffix == ".ipynb" else ".txt"
        name = f"files/{file.relative_to(Path(app.srcdir).resolve()).as_posix()}{as_text}"
        (target := Path(app.outdir) / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
        link.replace_self(nodes.reference("", "", *link.children, refuri=up + name, internal=True))


def first_page(app: Sphinx, error: Exception | None) -> None:
    """`index.html` leads to the first page."""
    if not error:
        leads = f'<meta http-equiv="refresh" content="0; url={root_doc}.html">'
        text = f'<!doctype html><meta charset="utf-8"><title>{project}</title>{leads}\n'
        (Path(app.outdir) / "index.html").write_text(text, encoding="utf-8")


def docstring(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Docstrings are plain text with `code`."""
    lines[:] = as_restructured_text(lines)


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", page_read)
    app.connect("doctree-read", link_to_files)
    app.connect("autodoc-process-docstring", docstring)
    app.connect("build-finished", first_page)
