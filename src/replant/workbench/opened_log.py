"""Opened: one log of a session; it is inspected and read in the background whenever the choices require it."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from replant.errors import InvalidArgumentError, ReplantError
from replant.numerics.operating_system import Worker, one_line
from replant.workbench import tasks
from replant.workbench.choices import Setup, Wish
from replant.workbench.drawn_samples import CancelledError, Clock, Samples
from replant.workbench.tasks import Work

MOST_DRAWN = 24  # most columns of a log that are drawn [count]
INSPECTING, READING, READY, BROKEN = "inspecting", "reading", "ready", "broken"
SHOWN = ("number", "key", "name", "min", "max", "missing", "step", "quantised", "problem", "in_record")
ROLES = ("input", "output", "reference")


class Opened:
    """A log with its inspection and the user's choices, which may come from an earlier session or from a guess."""

    def __init__(
        self, name: str, path: Path, work: Work, changed: Callable[[], object], setup: Setup, wish: Wish
    ) -> None:
        self.name, self.path = name, path
        self.setup, self.wish = setup, wish
        self.look: dict[str, Any] = {}
        self.state, self.error, self.rows, self.about = INSPECTING, "", 0, 0
        self.modified = _modified(path)
        self.samples = Samples(path)
        self._work, self._changed = work, changed
        self._is_new, self._closed = not setup.input, False
        self._asked = threading.Event()
        Worker(self._read_when_asked).start()
        self.refresh()

    def refresh(self) -> None:
        """Inspect and read the log as far as needed; if that is running, do it once more afterwards."""
        self._asked.set()

    def read_again(self) -> None:
        """Discard the samples and read the file again, as for a growing record."""
        if self.state in (INSPECTING, READING):
            return
        self.samples.close()
        self.samples, self.modified = Samples(self.path), _modified(self.path)
        self.refresh()

    def close(self) -> None:
        """Stop reading, and discard the samples."""
        self._closed = True
        self._asked.set()

    def _read_when_asked(self) -> None:
        while self._asked.wait() and not self._closed:
            self._asked.clear()
            self._try()
        self.samples.close()

    def _try(self) -> None:
        try:
            self._tell(INSPECTING)
            self._inspect()
            self._tell(READING)
            self.samples.read(self._drawn(), self._progress)
            self._tell(READY)
        except CancelledError:
            pass
        except (ReplantError, OSError) as error:
            self.error = one_line(error)
            self._tell(BROKEN)
        except Exception as error:
            logging.getLogger("replant.workbench").exception("%s could not be read", self.path)
            self.error = f"{self.path.name}: {type(error).__name__}; the terminal shows more"
            self._tell(BROKEN)

    def _tell(self, state: str) -> None:
        self.state = state
        self._changed()

    def _inspect(self) -> None:
        chosen = (self.setup.input, self.setup.output, self.setup.time)
        self.look = self._work.do(tasks.look, str(self.path), chosen)
        self.error = ""
        if self._is_new:
            self._is_new = False
            self.setup = guessed(self.setup, self.look)

    def _drawn(self) -> list[int]:
        """Return the columns to read: those with a role, then others up to `MOST_DRAWN`."""
        columns = [each for each in self.look["columns"] if each["in_record"]]
        of_role = {self.role_of(each): each["number"] for each in columns}
        clock = self.look["clock_number"]
        first = [of_role[role] for role in ROLES if role in of_role] + ([] if clock is None else [clock])
        rest = [each["number"] for each in columns if each["number"] not in first]
        return [*dict.fromkeys(first), *rest][: max(MOST_DRAWN, len(first))]

    def role_of(self, column: dict[str, Any]) -> str:
        """Return the role of a column; empty if it is not used."""
        for role in ROLES:
            if getattr(self.setup, role) == column["key"]:
                return role
        if self.setup.dt is not None:
            return ""
        is_time = self.setup.time == column["key"] if self.setup.time else column["looks_like"] == "time"
        return "time" if is_time else ""

    def _progress(self, rows: int, about: int) -> bool:
        if self._closed:
            return False
        if rows - self.rows > about / 50 or rows < self.rows:
            self.rows, self.about = rows, about
            self._changed()
        return True

    @property
    def clock(self) -> Clock:
        """The times of the rows."""
        found = self.look.get("clock") or {}
        dt = self.setup.dt or found.get("dt") or 1.0
        number = self.look.get("clock_number")
        if self.setup.dt is not None or number not in self.samples.columns or found.get("not_rising"):
            return Clock(None, 1.0, dt)
        return Clock(number, found.get("unit_in_seconds") or 1.0, dt)

    def drawn(self, between: tuple[float, float] | None, points: int) -> dict[str, Any]:
        """Return the signals between two times in s, thinned; see `Samples.drawn`."""
        if not self.samples.columns:
            return {"columns": {}, "rows": 0, "all": [0.0, 1.0]}
        clock = self.clock
        shown = [number for number in self._drawn() if number != clock.number]
        return self.samples.drawn(shown, clock, between, points)

    def view(self) -> dict[str, Any]:
        """Return the data that the page shows besides the signals."""
        columns = [
            {key: each[key] for key in SHOWN}
            | {"role": self.role_of(each), "drawn": each["number"] in self.samples.columns}
            for each in self.look.get("columns", ())
        ]
        return {
            "name": self.name, "file": self.path.name, "path": str(self.path), "state": self.state, "error": self.error,
            "read": min(1.0, self.rows / self.about) if self.about and self.state == READING else None,
            "rows": self.samples.rows, "columns": columns, "findings": self.look.get("findings", []),
            "doubts": self.look.get("doubts", []),
            "delay": self.look.get("delay"), "dt": (self.look.get("clock") or {}).get("dt"), "setup": vars(self.setup),
            "wish": vars(self.wish), "grown": self.has_changed, "version": self.modified,
        }  # fmt: skip

    @property
    def has_changed(self) -> bool:
        """Whether the file has changed since it was read."""
        return _modified(self.path) != self.modified

    def kept(self) -> dict[str, Any]:
        """Return the log for the file of a session."""
        return {"name": self.name, "path": str(self.path), "setup": vars(self.setup), "wish": vars(self.wish)}


def guessed(setup: Setup, look: dict[str, Any]) -> Setup:
    """Return a setup with the roles and the clock that the inspection suggests."""
    roles = {each["looks_like"]: each["key"] for each in reversed(look["columns"]) if each["looks_like"]}
    setup = setup.changed({role: roles.get(role, "") for role in ROLES})
    clock = look["clock"]
    if clock is None or clock["dt"] is None:
        return replace(setup, dt=1.0)
    if clock["problem"]:
        return replace(setup, dt=float(f"{clock['dt']:.6g}"))
    return replace(setup, time=roles.get("time", "")) if clock["guess"] else setup


def with_role(opened: Opened, key: str, role: str) -> Setup:
    """Return the setup of a log in which a column takes over a role; "" for none."""
    if role not in ("time", *ROLES, ""):
        raise InvalidArgumentError("a column is time, input, output, reference or unused")
    setup = opened.setup
    for each in ROLES:
        if getattr(setup, each) == key:
            setup = setup.changed({each: ""})
    column = next((each for each in opened.look.get("columns", ()) if each["key"] == key), None)
    if column is None:
        raise ReplantError(f"there is no column {key!r}")
    was_time = opened.role_of(column) == "time"
    if role == "time":
        return replace(setup, time=key, dt=None)
    if was_time:
        setup = replace(setup, time="", dt=(opened.look.get("clock") or {}).get("dt") or 1.0)
    return setup.changed({role: key}) if role in ROLES else setup


def _modified(path: Path) -> float:
    """Return the modification time of a file, or of the newest part in a folder; 0 if it does not exist."""
    found = 0.0
    with contextlib.suppress(OSError):
        found = path.stat().st_mtime
        if path.is_dir():
            found = max([found, *(part.stat().st_mtime for part in path.iterdir())])
    return found
