"""The pages run as they stand: every command and every program in them, and what they print is what the pages say.

A block behind a comment ``<!-- not run: reason -->`` is left out; so are the pages whose blocks need a rig.  The page
of the closed loop has a test of its own.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from replant.cli import main
from support.places import ROOT

PAGES = ["README.md", "docs/models.md"]
BLOCK = re.compile(r"^(?:<!-- not run: (.*?) -->\n)?```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def blocks(page: str) -> list[tuple[str | None, str, str]]:
    """Why a block is not run, its language, and its text."""
    return [(found[1], found[2], found[3]) for found in BLOCK.finditer((ROOT / page).read_text(encoding="utf-8"))]


def typed(block: str) -> None:
    """Run the commands of a block."""
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        if words:
            assert words[0] == "replant", line
            main(words[1:])


def printed_by(kind: str, block: str, names: dict[str, Any]) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        if kind == "sh":
            typed(block)
        else:
            exec(compile(block, "page", "exec"), names)
    return out.getvalue()


def plain(text: str) -> str:
    return "\n".join(line.rstrip() for line in text.strip("\n").splitlines())


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_says_is_printed(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    names: dict[str, Any] = {}
    output, run = "", 0
    checker = doctest.OutputChecker()
    for not_run, kind, block in blocks(page):
        if kind in ("sh", "python"):
            output = "" if not_run else printed_by(kind, block, names)
            run += not not_run
        elif kind == "text":
            want, got = plain(block) + "\n", plain(output) + "\n"
            assert checker.check_output(want, got, doctest.ELLIPSIS), f"{page} says\n{want}\nit prints\n{got}"
    assert run > 1
