"""Actions: what a page may do to a session; each takes the session and an object of JSON."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from replant.errors import InvalidArgumentError
from replant.workbench.opened import with_role
from replant.workbench.session import Session
from replant.workbench.setup import text

Given = dict[str, Any]


def _word(given: Given, name: str) -> str:
    return text(name, given.get(name, ""))


def _activate(session: Session, given: Given) -> None:
    session.active = session.log(_word(given, "log")).name


def _close(session: Session, given: Given) -> None:
    session.close_log(_word(given, "log"))


def _again(session: Session, given: Given) -> None:
    session.log(_word(given, "log")).read_again()


def _role(session: Session, given: Given) -> None:
    log = session.log(_word(given, "log"))
    role = _word(given, "role")
    if role not in ("time", "input", "output", "reference", ""):
        raise InvalidArgumentError("a column is time, input, output, reference or unused")
    session.choose(log.name, with_role(log, _word(given, "column"), role))


def _setup(session: Session, given: Given) -> None:
    log = session.log(_word(given, "log"))
    session.choose(log.name, log.setup.changed(_object(given, "setup")))


def _wish(session: Session, given: Given) -> None:
    log = session.log(_word(given, "log"))
    log.wish = log.wish.changed(_object(given, "wish"))


def _fit(session: Session, given: Given) -> Given:
    log = session.log(_word(given, "log"))
    return {"made": session.fit(log.name, log.wish.changed(_object(given, "wish")))}


def _stop(session: Session, given: Given) -> None:
    session.jobs.stop(session.card(_word(given, "card")).name)


def _repeat(session: Session, given: Given) -> None:
    session.again(_word(given, "card"))


def _rename(session: Session, given: Given) -> None:
    session.rename(_word(given, "card"), _word(given, "title"))


def _remove(session: Session, given: Given) -> None:
    session.remove(_word(given, "card"))


def _sort(session: Session, given: Given) -> None:
    session.sort(_word(given, "order"))


def _show(session: Session, given: Given) -> None:
    """Choose which models are compared."""
    session.show(session.card(_word(given, "card")).name, chosen=bool(given.get("chosen")))


def _object(given: Given, name: str) -> Given:
    found = given.get(name, {})
    if not isinstance(found, dict):
        raise InvalidArgumentError(f"{name} must be an object of JSON")
    return found


ACTIONS: dict[str, Callable[[Session, Given], Given | None]] = {
    "activate": _activate,
    "close": _close,
    "read-again": _again,
    "role": _role,
    "setup": _setup,
    "wish": _wish,
    "fit": _fit,
    "stop": _stop,
    "repeat": _repeat,
    "rename": _rename,
    "remove": _remove,
    "sort": _sort,
    "show": _show,
}
