"""Cards: the models of a session, and the plots that show the reasons of a verdict."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from replant.report.findings import words_of as verdict_words
from replant.workbench.choices import RUN, SEARCH, Setup, Wish, command_line, program, text, words_of

_NUMBER = r"([-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?)"
_LAST = re.compile(rf"(?:over|of|for) the last {_NUMBER} s")
_AGO = re.compile(rf"{_NUMBER} s (?:ago|before the end)")
_POLE = re.compile(rf"(?:a pole at|near) {_NUMBER}(?: \+- {_NUMBER}j)? rad/s")
_INPUT = re.compile(r"the (?:input|reference) could explain|dead time of|the input seems to act|actuator seems")
_GAIN = re.compile(r"abs G|standard deviation|condition number|does not excite")
_OUTPUT = re.compile(r"constant to the bit|extreme of the output|no output has arrived|left out|sensor was stuck")
_COLOUR = re.compile(r"noise model|residual")


@dataclass(frozen=True)
class Place:
    """The plot, and the part of it, that shows a reason."""

    plot: str  # {"output", "residual", "cross", "auto", "bode", "poles"}
    since: float | None = None  # start of the stretch, in s before the end of the record; None: the whole record
    at: float | None = None  # frequency in rad/s


def place_of(reason: str) -> Place:
    """Return the plot that shows a reason."""
    since = _first(_AGO, reason) or _first(_LAST, reason)
    found = _POLE.search(reason)
    if found:
        real, imag = (0.0 if each is None else _value(each) for each in found.groups())
        return Place("poles", since, round((real**2 + imag**2) ** 0.5, 12))
    for pattern, plot in ((_OUTPUT, "output"), (_INPUT, "cross"), (_AGO, "residual"), (_COLOUR, "auto")):
        if pattern.search(reason):
            return Place(plot, since)
    if _GAIN.search(reason) and "fits the output" not in reason:
        return Place("bode", since)
    return Place("output", since)


def _first(pattern: re.Pattern[str], reason: str) -> float | None:
    found = pattern.search(reason)
    return None if found is None else _value(found[1])


def _value(text: str) -> float:
    return float(text.replace(",", ""))


WAITING, RUNNING, DONE, FAILED, STOPPED = "waiting", "running", "done", "failed", "stopped"
OPEN = (WAITING, RUNNING)
LIKELY = 6  # most candidates of a search that a card lists [count]
ORDERS = ("made", "fit", "poles", "name")


@dataclass(frozen=True)
class Card:
    """A model, or the attempt to make one."""

    name: str  # name, title: the session's identifier, and the user's name for it
    title: str
    log: str  # name of the log in the session
    path: Path
    setup: Setup
    wish: Wish
    words: tuple[str, ...]  # the command that makes it
    state: str = WAITING
    stage: str = ""  # stage, percent: progress
    percent: int = 0
    error: str = ""
    found: dict[str, Any] = field(default_factory=dict)  # the JSON object of the command
    model: str = ""  # content of the model's file

    def view(self, *, names_log: bool = False) -> dict[str, Any]:
        """Return the data that the page shows; with the file of the log in the title if models are of several."""
        title = f"{self.title}, {self.path.name}" if names_log else self.title
        shown: dict[str, Any] = {
            "name": self.name, "title": title, "given": self.title, "log": self.log,
            "source": self.path.name, "kind": self.wish.kind, "state": self.state, "stage": self.stage,
            "percent": self.percent, "error": self.error,
            "command": command_line(self.words), "python": program(self.path, self.setup, self.wish),
        }  # fmt: skip
        return shown | (_result(self.found) if self.state == DONE else {})

    def kept(self) -> dict[str, Any]:
        """Return the card for the file of a session."""
        state = STOPPED if self.state in OPEN else self.state
        return {**asdict(self), "path": str(self.path), "words": list(self.words), "state": state}


def title_of(wish: Wish) -> str:
    """Return the default title of a card."""
    if wish.kind == SEARCH:
        return f"best of {wish.poles} poles"
    parts = [f"{wish.poles} pole{'' if wish.poles == '1' else 's'}"]
    parts += [f"{wish.zeros} zero{'' if wish.zeros == '1' else 's'}"] if wish.zeros not in ("", "0") else []
    parts += [f"{float(wish.delay):g} s"] if float(wish.delay) else []
    return ", ".join(parts) + (", online" if wish.kind == RUN else "")


def _result(found: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a model that a card shows."""
    words = verdict_words(found["verdict"]["status"])
    unseen = [
        {"on": each["source"].partition(", ")[2] or each["source"], "fit": each["fit"]["simulated"],
         "verdict": judged(each["verdict"])}
        for each in found.get("validations", ())
    ]  # fmt: skip
    candidates = [each for each in found.get("candidates", ()) if each["criterion"] is not None]
    candidates.sort(key=lambda each: each["criterion"])
    likely = [
        {**each, "behind": 0.5 * (each["criterion"] - candidates[0]["criterion"])} for each in candidates[:LIKELY]
    ]
    return {
        "num": found["num"], "den": found["den"], "delay": found["delay"], "poles": found["structure"]["poles"],
        "zeros": found["structure"]["zeros"], "fit": found["fit"]["simulated"], "one_step": found["fit"]["one_step"],
        "samples": found["samples"], "known": _known(found["parameters"]), "unusable": not words.usable,
        "verdict": judged(found["verdict"]), "unseen": unseen, "candidates": likely,
        "tried": len(found.get("candidates", ())), "seconds": found.get("elapsed_seconds"),
        "left_out": {reason: count for reason, count in found["rejected"].items() if count},
    }  # fmt: skip


def judged(verdict: dict[str, Any]) -> dict[str, Any]:
    """Return a verdict in JSON form with its texts, its gravity and the plots that show its reasons."""
    words = verdict_words(verdict["status"])
    reasons = [{"text": reason, **asdict(place_of(reason))} for reason in verdict["reasons"]]
    return {"gravity": words.gravity, "headline": words.headline, "meaning": words.text, "reasons": reasons}


def _known(parameters: dict[str, dict[str, float | None]]) -> float | None:
    """Return the largest relative standard deviation of a coefficient; None if none is known."""
    parts = [
        each["std"] / abs(each["value"]) for each in parameters.values() if each["std"] is not None and each["value"]
    ]
    return max(parts, default=None)


def _sort_key(card: Card, order: str) -> Any:
    if order == "name":
        return card.title.casefold()
    if card.state != DONE:
        return math.inf
    if order == "poles":
        return 100 * len(card.found["den"]) + len(card.found["num"])
    unseen = [each["fit"]["simulated"] for each in card.found.get("validations", ())]
    fits = [fit for fit in (unseen or [card.found["fit"]["simulated"]]) if fit is not None]
    return -min(fits) if fits else math.inf


def in_order(cards: Sequence[Card], order: str) -> list[Card]:
    """Sort cards by one of `ORDERS`: "made" keeps their order, "fit" puts the best on unseen samples first."""
    return list(cards) if order == "made" else sorted(cards, key=lambda card: _sort_key(card, order))


def card_of(kept: dict[str, Any]) -> Card:
    """Return a card from the file of a session; raise KeyError, TypeError or ValueError if it is invalid."""
    given = {each.name: kept[each.name] for each in dataclasses.fields(Card)}
    given["setup"], given["wish"] = Setup().changed(kept["setup"]), Wish().changed(kept["wish"])
    given["path"] = Path(kept["path"])
    given["words"] = words_of(given["path"], given["setup"], given["wish"])  # never run a command from a file
    given["model"] = str(given["model"])
    for key in ("name", "title", "log", "stage", "error", "state"):
        given[key] = text(key, given[key])
    card = Card(**given)
    if card.state == DONE:
        card.view()  # raises if figures are missing
    return card
