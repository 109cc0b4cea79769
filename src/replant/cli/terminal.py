"""The terminal: characters it can show, words typed nearly right, notes on standard error, examples of help."""

from __future__ import annotations

import codecs
import io
import re
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import Any

import click

PLAIN = "replant.plain"  # the error handler's name
_SIGNS = str.maketrans({"±": "+-", "−": "-", "–": "-", "×": "x", "µ": "u", "μ": "u", "°": "deg", "∞": "inf"})
_SUPERSCRIPTS = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"
_LOWERED = str.maketrans(_SUPERSCRIPTS, "-0123456789")


def replace_unencodable() -> None:
    """Have standard output and error write ASCII for characters that their encoding lacks."""
    codecs.register_error(PLAIN, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)


def to_ascii(text: str) -> str:
    r"""Return text in ASCII; a character without a similar one in ASCII is written as its number."""
    text = re.sub(f"[{_SUPERSCRIPTS}]+", lambda found: "^" + found[0].translate(_LOWERED), text)
    return text.translate(_SIGNS).encode("ascii", "backslashreplace").decode("ascii")


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return to_ascii(error.object[error.start : error.end]), error.end


NEAR = 0.6  # likeness from which on a word is taken for a misspelling [ratio of difflib]


def did_you_mean(word: str, words: Sequence[str]) -> str:
    """Return a question for the nearest of ``words``; empty if none is near."""
    near = get_close_matches(_plain(word), words, n=1, cutoff=NEAR)
    return f"did you mean {near[0]!r}?" if near else ""


def _plain(word: str) -> str:
    return word.lower().replace("-", "_")


class Choice(click.Choice[str]):
    """The type of options that are one of several words, in any case, with - or _; a near one is proposed."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the word as the option knows it."""
        found = next((choice for choice in self.choices if _plain(choice) == _plain(str(value))), None)
        if found is None:
            listed = ", ".join(map(repr, self.choices))
            question = did_you_mean(str(value), self.choices)
            near = f" ({question})" if question else ""
            self.fail(f"{value!r} is not one of {listed}{near}.", param, ctx)
        return found


class Parsed(click.ParamType[Any]):
    """The type of options that a function reads, which raises ValueError for a text that it cannot read."""

    def __init__(self, name: str, read: Callable[[str], Any], wrong: str) -> None:
        self.name, self._read, self._wrong = name, read, wrong

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return what the option says."""
        if not isinstance(value, str):
            return value
        try:
            return self._read(value)
        except ValueError:
            self.fail(f"{value!r} {self._wrong}", param, ctx)


QUIET, ASKED = "replant.quiet", "replant.progress"
SAID = "replant.said"  # notes that were printed
TYPED = "replant.typed"  # the words behind the name of the command that is running


def is_quiet(flag: str = QUIET) -> bool:
    """Return whether the command that is running was called with --quiet, or with --progress, `ASKED`."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(flag))


def note(text: str) -> None:
    """Print a note in one line to standard error, once in a command."""
    context = click.get_current_context(silent=True)
    said: set[str] = set() if context is None else context.meta.setdefault(SAID, set())
    if not is_quiet() and text not in said:
        said.add(text)
        click.echo(f"replant: note: {text}", err=True)


EXAMPLES = {
    "replant": (
        ("look, cut, fit and compare on a page", "replant open log.csv"),
        ("see what is in a log, and what to type next", "replant look log.csv"),
        ("fit two poles to all of it", "replant fit log.csv -i u -o y -p 2"),
        ("watch a simulated rig live, without hardware", "replant live demo --for 20s"),
    ),
    "open": (
        ("a log on a page", "replant open log.csv"),
        ("the session that was open last", "replant open"),
    ),
    "look": (
        ("columns, clock, likely input and output", "replant look log.csv"),
        ("the same with a plot of the columns", "replant look log.csv --out plots"),
        ("for scripts", "replant look log.csv -i u --json"),
    ),
    "run": (
        ("two poles, online", "replant run log.csv -i u -o y -p 2"),
        ("a zero, plots and a report", "replant run log.csv -i u -o y -p 2 --zeros 1 --out plots"),
        ("by the article's AMSGrad", "replant run log.csv -i u -o y -p 1 --optimizer amsgrad"),
    ),
    "fit": (
        ("two poles", "replant fit log.csv -i u -o y -p 2"),
        ("the number of poles chosen, and the dead time", "replant fit log.csv -i u -o y -p 1:3 --delay 0:0.2:0.1"),
        ("one model of two records", "replant fit log.csv log.csv -i u -o y -p 1"),
        ("the model kept", "replant fit log.csv -i u -o y -p 1 --save model.json"),
        ("for scripts", "replant fit log.csv -i u -o y -p 1 --json"),
    ),
    "compare": (
        ("a saved model over a log", "replant compare model.json log.csv"),
        ("the usual methods", "replant compare log.csv -i u -o y -p 1"),
        ("two of them", "replant compare log.csv -i u -o y -p 1 --optimizer srivc --optimizer least-squares"),
    ),
    "validate": (
        ("another log, with the columns that the model knows", "replant validate model.json log.csv"),
        ("a plot, and exit code 3 unless trusted", "replant validate model.json log.csv --out plots --require trusted"),
    ),
    "show": (("the model as people read it", "replant show model.json"), ("as JSON", "replant show model.json --json")),
    "fleet": (
        ("each file a rig, on every core", "replant fleet '*.csv' --by file -i u -o y -p 2 --out fleet"),
        (
            "each folder a rig, by the fit of whole records",
            "replant fleet . --by folder -i u -o y -p 2 --method fit --on processes:2 --out fleet",
        ),
    ),
    "examples": (("records of a motor, into this folder", "replant examples"),),
    "live": (
        ("a simulated rig, with a dashboard", "replant live demo --for 20s"),
        ("the same in the terminal, until it is trusted", "replant live demo --dashboard off --until trusted"),
    ),
    "demo": (("plots and a report", "replant demo --out plots"),),
    "reproduce": (
        ("one table", "replant reproduce table1"),
        ("for scripts", "replant reproduce table1 --json"),
    ),
}


def epilog_of(command: str) -> str:
    r"""Return the examples of a command as click's epilog, whose lines stay as they are."""
    lines = [line for what, typed in EXAMPLES[command] for line in (f"  # {what}", f"  {typed}")]
    return "\n".join(["\b", "Examples:", *lines])
