"""A page that stands alone: its frame and style, and uPlot, which draws its interactive plots.

They belong to the package but not to the repository: `hatch_build.py` fetches them when the package is built.  Where
that failed, those of the package uplot-python are used.
"""

from __future__ import annotations

import html
import importlib.util
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from replant.errors import MissingDependencyError

OWN = "uPlot.iife.min.js", "uPlot.min.css"
UPLOT_PYTHON = "uPlot.iife.js", "uPlot.min.css"


@cache
def uplot() -> tuple[str, str]:
    """Return uPlot's script and style sheet."""
    own = resources.files("replant.report").joinpath("assets", "uplot")
    places = [(own, OWN)]
    spec = importlib.util.find_spec("uplot")  # need not be imported for its files
    places += [(Path(folder, "static"), UPLOT_PYTHON) for folder in (spec and spec.submodule_search_locations) or ()]
    for folder, names in places:
        script, style = (folder.joinpath(name) for name in names)
        if script.is_file() and style.is_file():
            return script.read_text(encoding="utf-8"), style.read_text(encoding="utf-8")
    raise MissingDependencyError(
        "the report and the dashboard need uPlot, which was not fetched when replant was installed: "
        "install npm and then replant once more, or: pip install --no-deps uplot-python"
    )


_ICONS = {  # they differ in shape as well as in colour
    "good": '<circle cx="12" cy="12" r="11"/><path class="mark" d="M6.5 12.5l3.7 3.7 7.3-8"/>',
    "warn": '<path d="M12 1.5L23.5 22H.5z"/><path class="mark" d="M12 9v6M12 18v.6"/>',
    "bad": '<path d="M7.4 1h9.2L23 7.4v9.2L16.6 23H7.4L1 16.6V7.4z"/><path class="mark" d="M8 8l8 8M16 8l-8 8"/>',
}


NO_BREAK = "\u00a0"  # a space at which a line may not end


class Html(str):
    """Text that is HTML already; plain text is escaped."""

    __slots__ = ()


def words(text: str) -> Html:
    r"""Return plain text as HTML without line breaks after a plus-minus sign or before a percent sign."""
    return Html(html.escape(text.replace("± ", "±" + NO_BREAK).replace(" %", NO_BREAK + "%")))


@cache
def asset(name: str) -> str:
    """Return the text of a file in ``report/assets``."""
    return resources.files("replant.report").joinpath("assets", name).read_text(encoding="utf-8")


def script(*names: str) -> str:
    """Return modules of JavaScript as one script, those that others import first."""
    text = re.sub(r"^import .*\n|^export (?=const|function)", "", "".join(map(asset, names)), flags=re.MULTILINE)
    return f'(() => {{\n"use strict";\n{text}}})();\n'


def heading(title: str) -> str:
    """Return an escaped title that may break after underscores: it is usually the name of a file."""
    return html.escape(title).replace("_", "_<wbr>")


def filled(name: str, fields: Mapping[str, str]) -> str:
    """Return a template in ``report/assets`` with its fields, which are HTML."""
    return Template(asset(name)).substitute(fields)


def page(
    *, title: str, eyebrow: str, lede: str, body: str, css: str = "", data: Any = None, scripts: Sequence[str] = ()
) -> str:
    """Return a page that stands alone: ``data`` are for its scripts, which follow in their order."""
    parts = [text.replace("</script", "<\\/script") for text in scripts]
    told = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    given = f'<script type="application/json" id="data">{told}</script>\n' if scripts else ""
    fields = {
        "title": html.escape(title),
        "heading": heading(title),
        "eyebrow": html.escape(eyebrow),
        "lede": html.escape(lede),
        "body": body,
        "css": asset("palette.css") + asset("report.css") + css,
        "policy": "script-src 'unsafe-inline';" if scripts else "",
        "scripts": given + "".join(f"<script>\n{text}</script>\n" for text in parts),
        "date": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
    }
    return filled("page.html", fields)


def write_page(path: Path, **parts: Any) -> Path:
    """Write a page into one self-contained file, and return its path."""
    text = page(**parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def icon(gravity: str) -> str:
    """Return the icon of a gravity: "good", "warn" or "bad"."""
    return f'<svg class="icon {gravity}" viewBox="0 0 24 24" aria-hidden="true">{_ICONS[gravity]}</svg>'


def section(name: str, *parts: str, anchor: str = "") -> str:
    """Return a section of a page."""
    title = f"<h2>{html.escape(name)}</h2>" if name else ""
    place = f' id="{html.escape(anchor)}"' if anchor else ""
    return f"<section{place}>{title}{''.join(parts)}</section>"


def folded(name: str, content: str) -> str:
    """Return what few readers look for, behind its name; printed, it is unfolded."""
    return f'<details class="fold"><summary><h2>{html.escape(name)}</h2></summary>{content}</details>'


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """Return a list of terms and descriptions."""
    return "<dl>" + "".join(f"<dt>{html.escape(key)}</dt><dd>{html.escape(text)}</dd>" for key, text in rows) + "</dl>"


def code(kind: str, text: str) -> str:
    """Return a listing; ``kind`` is "shell" or "python"."""
    return f'<pre class="{kind}" tabindex="0"><code>{html.escape(text)}</code></pre>'


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], name: str, kind: str = "table") -> str:
    """Return a table whose first column holds the row headings."""
    head = "".join(f'<th scope="col">{_escaped(heading)}</th>' for heading in headings)
    body = "".join(
        f'<tr><th scope="row">{_escaped(first)}</th>' + "".join(f"<td>{_escaped(cell)}</td>" for cell in rest) + "</tr>"
        for first, *rest in rows
    )
    inner = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="{kind}" role="region" tabindex="0" aria-label="{html.escape(name)}">{inner}</div>'


def _escaped(cell: str) -> str:
    return cell if isinstance(cell, Html) else words(cell)
