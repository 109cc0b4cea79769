"""Places: where sessions, logs that were dropped and the token are kept between two starts."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path

from replant.errors import ReplantError
from replant.operating_system.os_errors import one_line


def folder() -> Path:
    """Return the folder of the workbench, which only its user may read."""
    given = os.environ.get("XDG_STATE_HOME") or (os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else "")
    found = Path(given or Path.home() / ".local" / "state") / "replant"
    try:
        found.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise ReplantError(f"{one_line(error)}; XDG_STATE_HOME names another folder to keep sessions in") from None
    return found


def logs_folder() -> Path:
    """Return the folder of logs that were dropped on the page."""
    found = folder() / "logs"
    found.mkdir(exist_ok=True)
    return found


def session_of(logs: Sequence[Path]) -> Path:
    """Return the file that keeps the session of these logs."""
    named = "\n".join(sorted(str(path.absolute()) for path in logs))
    sessions = folder() / "sessions"
    sessions.mkdir(exist_ok=True)
    return sessions / f"{hashlib.sha256(named.encode('utf-8', 'surrogateescape')).hexdigest()[:16]}.workbench"


def newest_session() -> Path:
    """Return the file of the session that was open last, or that of no logs."""
    none = session_of(())
    return max(none.parent.glob("*.workbench"), key=lambda path: path.stat().st_mtime, default=none)


def token() -> str:
    """Return the token of this user: the same at every start, so that an open page comes back."""
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
