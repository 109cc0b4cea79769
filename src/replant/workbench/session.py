"""Session: the logs and cards of a workbench, and the files that keep them."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from replant.errors import InvalidArgumentError, ReplantError, shown
from replant.numerics.operating_system import one_line, reason_of, replacing
from replant.workbench.choices import Setup, Wish, text, words_of
from replant.workbench.model_cards import DONE, OPEN, ORDERS, Card, card_of, in_order, title_of
from replant.workbench.opened_log import BROKEN, Opened
from replant.workbench.tasks import Jobs, Work

SUFFIX = ".workbench"

T = TypeVar("T")


def folder(inner: str = "") -> Path:
    """Return the workbench's folder, readable only by its user, or its subfolder ``inner``: logs, sessions."""
    given = os.environ.get("XDG_STATE_HOME") or (os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else "")
    found = Path(given or Path.home() / ".local" / "state") / "replant"
    try:
        found.mkdir(mode=0o700, parents=True, exist_ok=True)
        (found / inner).mkdir(exist_ok=True)
    except OSError as error:
        raise ReplantError(f"{one_line(error)}; set XDG_STATE_HOME to another folder for the sessions") from None
    return found / inner


def session_of(logs: Sequence[Path]) -> Path:
    """Return the file that keeps the session of these logs."""
    named = "\n".join(sorted(str(path.absolute()) for path in logs))
    return folder("sessions") / f"{hashlib.sha256(named.encode('utf-8', 'surrogateescape')).hexdigest()[:16]}{SUFFIX}"


def newest_session() -> Path:
    """Return the file of the newest session; if there is none, the file of a session without logs."""
    kept = folder("sessions").glob(f"*{SUFFIX}")
    return max(kept, key=lambda path: path.stat().st_mtime, default=session_of(()))


def token() -> str:
    """Return the token of this user, the same at every start, so that an open page reconnects."""
    path = folder() / "token"
    with contextlib.suppress(OSError):
        found = path.read_text(encoding="ascii").strip()
        if len(found) >= 32 and found.isalnum():
            return found
    made = secrets.token_hex(16)
    path.unlink(missing_ok=True)
    path.touch(mode=0o600)
    path.write_text(made + "\n", encoding="ascii")
    return made


FORM = 1  # version of the file of a session [number]
SAVING = 0.3  # delay from a change until the session is saved [s]
MOST_LOGS = 32  # most logs of a session [count]
MOST_SHOWN = 6  # most models that are compared: the number of colours [count]
LARGEST = 256 << 20  # largest file of a session [bytes]


class Session:
    """The whole state of the pages; it is held here and in the file, not in a browser."""

    def __init__(self, kept_in: Path, publish: Callable[[dict[str, Any]], None]) -> None:
        self.kept_in, self._publish = kept_in, publish
        self.work, self.jobs = Work(), Jobs(self._told)
        self.logs: dict[str, Opened] = {}
        self.cards: dict[str, Card] = {}
        self.active, self.order, self.shown = "", "made", list[str]()
        self.lock = threading.RLock()
        self._number, self._closed, self._grown = 0, False, set[str]()
        self._revision = 0  # number of views published to the pages
        self._timer: threading.Timer | None = None

    # --- what the pages see ---

    def changed(self) -> int:
        """Publish a view to all pages, and save the session soon; return the revision of the view."""
        with self.lock:
            if self._closed:
                return self._revision
            self._revision += 1
            self._publish(self.view())
            if self._timer is None:
                self._timer = threading.Timer(SAVING, self.keep)
                self._timer.daemon = True
                self._timer.start()
            return self._revision

    def view(self) -> dict[str, Any]:
        """Return the state of the session for the pages."""
        with self.lock:
            cards = in_order(list(self.cards.values()), self.order)
            several = len({each.path for each in cards}) > 1
            return {
                "logs": [each.view() for each in self.logs.values()],
                "cards": [each.view(names_log=several) for each in cards],
                "active": self.active, "order": self.order, "shown": self.shown, "revision": self._revision,
            }  # fmt: skip

    def log(self, name: str) -> Opened:
        """Return a log of the session."""
        return _held(self.logs, name, "log")

    def card(self, name: str) -> Card:
        """Return a card of the session."""
        return _held(self.cards, name, "model")

    # --- logs ---

    def open(self, path: Path, setup: Setup = Setup(), wish: Wish = Wish(), name: str = "") -> Opened:  # noqa: B008
        """Open a log, or activate it if it is open."""
        path = path.absolute()
        path = path / "samples" if (path / "samples").is_dir() else path  # of a live session
        with self.lock:
            same = next((each for each in self.logs.values() if each.path == path), None)
            if same is None:
                if len(self.logs) >= MOST_LOGS:
                    raise InvalidArgumentError(f"{MOST_LOGS} logs are open: close some first")
                same = Opened(name or self._next("log"), path, self.work, self.changed, setup, wish)
                self.logs[same.name] = same
            self.active = same.name
        self.changed()
        return same

    def activate(self, log: str) -> None:
        """Show a log."""
        self.active = self.log(log).name

    def close_log(self, log: str) -> None:
        """Close a log; its models stay."""
        with self.lock:
            self.log(log).close()
            del self.logs[log]
            if self.active == log:
                self.active = next(reversed(self.logs), "")

    def choose(self, name: str, change: Callable[[Opened], Setup]) -> None:
        """Change the setup of a log; inspect the log again if its roles or clock have changed."""
        with self.lock:
            log = self.log(name)
            before, log.setup = log.setup, change(log)
            setup = log.setup
        roles = ("input", "output", "reference", "time", "dt")
        if any(getattr(before, each) != getattr(setup, each) for each in roles):
            log.refresh()

    def set_wish(self, log: str, wish: dict[str, Any]) -> None:
        """Change fields of the wish for models of a log."""
        opened = self.log(log)
        opened.wish = opened.wish.changed(wish)

    def look_for_growth(self) -> None:
        """Tell the pages which logs have changed on disk, such as the record of a live session."""
        with self.lock:
            grown = {log.name for log in self.logs.values() if log.has_changed}
            for name in grown:
                if self.logs[name].state == BROKEN:  # such as a record whose first part was not written yet
                    self.logs[name].read_again()
            if grown == self._grown:
                return
            self._grown = grown
        self.changed()

    # --- models ---

    def fit(self, log: str, wish: dict[str, Any]) -> list[str]:
        """Start jobs for the requested models of a log; return the names of their cards."""
        self.set_wish(log, wish)
        with self.lock:
            opened = self.log(log)
            opened.setup.check()
            made = []
            for each in opened.wish.alone:
                words = words_of(opened.path, opened.setup, each)
                made.append(Card(self._next("m"), title_of(each), log, opened.path, opened.setup, each, words))
            self.cards |= {card.name: card for card in made}
        for card in made:
            self.jobs.start(card.name, card.words)
        return [card.name for card in made]

    def stop(self, card: str) -> None:
        """Stop the job of a card."""
        self.jobs.stop(self.card(card).name)

    def again(self, card: str) -> None:
        """Run the job of a card again, after it was stopped or failed."""
        with self.lock:
            waiting = replace(self.card(card), state="waiting", error="", percent=0, stage="")
            self.cards[card] = waiting
        self.jobs.start(card, waiting.words)

    def rename(self, card: str, title: str) -> None:
        """Give a card another title."""
        self.cards[card] = replace(self.card(card), title=title.strip() or self.card(card).title)

    def remove(self, card: str) -> None:
        """Remove a card, and stop its job."""
        with self.lock:
            removed = self.card(card)
            del self.cards[card]
            self.show(card, chosen=False)
        if removed.state in OPEN:
            self.jobs.stop(card)

    @property
    def compared(self) -> list[str]:
        """The names of the compared cards."""
        return [name for name in self.shown if name]

    def show(self, card: str, chosen: bool) -> None:
        """Add a card to the comparison, or remove it.  Its position gives its colour: it takes the first free one."""
        if not chosen:
            self.shown = ["" if each == card else each for each in self.shown]
        elif self.card(card).name not in self.shown:
            if len(self.compared) >= MOST_SHOWN:
                raise InvalidArgumentError(f"{MOST_SHOWN} models are compared at a time: leave one out first")
            free = self.shown.index("") if "" in self.shown else len(self.shown)
            self.shown = [*self.shown[:free], card, *self.shown[free + 1 :]]

    def sort(self, order: str) -> None:
        """Show the cards in another order."""
        if order not in ORDERS:
            raise InvalidArgumentError(f"cards are sorted by {', '.join(ORDERS)}, not {shown(order)}")
        self.order = order

    def _told(self, name: str, changes: dict[str, Any]) -> None:
        """Apply a job's changes to its card, unless removed; add a new model to the comparison if there is room."""
        with self.lock:
            if name in self.cards:
                self.cards[name] = replace(self.cards[name], **changes)
                if self.cards[name].state == DONE and len(self.compared) < MOST_SHOWN:
                    self.show(name, chosen=True)
        self.changed()

    def _next(self, kind: str) -> str:
        self._number += 1
        return f"{kind}{self._number}"

    # --- the file ---

    def written(self) -> str:
        """Return the content of the session's file."""
        with self.lock:
            kept = {
                "replant_session": FORM, "number": self._number, "active": self.active, "order": self.order,
                "shown": self.shown, "logs": [each.kept() for each in self.logs.values()],
                "cards": [each.kept() for each in self.cards.values()],
            }  # fmt: skip
        return json.dumps(kept, indent=1, allow_nan=False) + "\n"

    def restore(self, written: str, source: str) -> None:
        """Replace the logs and cards by those of a session's file."""
        logs, cards, kept = parsed(written, source)
        with self.lock:
            for name in list(self.cards):
                self.remove(name)
            for name in list(self.logs):
                self.close_log(name)
            self._number = kept["number"]
            self.cards = {card.name: card for card in cards}
            self.shown = [name if name in self.cards else "" for name in kept["shown"][:MOST_SHOWN]]
            self.sort(kept["order"])
            for log in logs:
                self.open(*log)
            self.active = kept["active"] if kept["active"] in self.logs else self.active
        self.changed()

    def keep(self) -> None:
        """Save the session into its file."""
        with self.lock:
            self._timer = None
        with contextlib.suppress(OSError), replacing(self.kept_in) as new:  # a full disk must not stop the work
            new.write_text(self.written(), encoding="utf-8")

    def close(self) -> None:
        """Save the session, and stop its processes and threads."""
        self.keep()
        with self.lock:
            self._closed = True
        self.jobs.close()
        self.work.close()
        for log in self.logs.values():
            log.close()


def _held(held: dict[str, T], name: str, what: str) -> T:
    if name not in held:
        raise InvalidArgumentError(f"there is no {what} {shown(name)} in this session: reload the page")
    return held[name]


def parsed(written: str, source: str) -> tuple[list[tuple[Path, Setup, Wish, str]], list[Card], dict[str, Any]]:
    """Return logs, cards and the rest of a session's file; raise ReplantError if the file is invalid."""
    try:
        kept = json.loads(written)
        if kept["replant_session"] != FORM:
            raise ReplantError(f"{source}: a session of another version of replant ({kept['replant_session']!r})")
        logs = [
            (Path(log["path"]), Setup().changed(log["setup"]), Wish().changed(log["wish"]), text("name", log["name"]))
            for log in kept["logs"]
        ]
        cards = [card_of(each) for each in kept["cards"]]
        rest = {"number": int(kept["number"]), "active": str(kept["active"]), "order": kept["order"]}
        rest["shown"] = [str(name) for name in kept["shown"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        detail = reason_of(error)[:80]
        raise ReplantError(f"{source}: not a session of replant, or damaged ({detail})") from None
    return logs, cards, rest


def read(path: Path, source: str) -> str:
    """Return the content of a session's file, which errors call ``source``."""
    try:
        if path.stat().st_size > LARGEST:
            raise ReplantError(f"{source}: too large for a session")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ReplantError(f"{source}: not a session of replant") from None
    except OSError as error:
        raise ReplantError(f"{source}: cannot be read ({reason_of(error)}); check the path") from None
