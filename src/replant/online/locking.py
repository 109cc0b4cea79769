"""Turns: the calls on one object go one after the other, from whatever thread they come, and none is left half done.

A call has its turn as long as it holds a lock.  Taking one at every single sample would cost more than the sample: what
takes single samples passes a gate instead, one number that compiled code looks at (`replant.kernels.native`),
and waits for its turn only where that is shut.

A signal handler runs in the main thread between any two bytecodes, and may raise, as Ctrl-C does.  The interpreter
takes the lock of a ``with`` and gives it back in C, so that no lock stays taken.  What else a call leaves behind is up
to it: it works on a copy, and takes that over in one step (`Identifier._as_one`).
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, NoReturn, ParamSpec, TypeVar

from replant.errors import InUseError

P = ParamSpec("P")
R = TypeVar("R")
S = TypeVar("S", bound="Shared")


class Turn:
    """The locks of one object: ``lock`` is the turn of a thread; within it ``inside`` tells a call within a call."""

    def __init__(self) -> None:
        self.lock: Any = threading.RLock()
        self.inside: Any = threading.Lock()
        self.changing = False  # whether the call that was let in last may change something
        _EVERY.add(self)

    def begin_child(self) -> None:
        """Free a forked process of the call of a thread that it has not got; refuse what that may have torn."""
        if self.lock.acquire(blocking=False):  # free, or of the thread that forked
            self.lock.release()
            return
        torn = self.changing and self.inside.locked()
        self.lock, self.inside = threading.RLock(), _Torn() if torn else threading.Lock()


class _Torn:
    """Stands for ``inside`` where another thread was changing the object as the process forked."""

    def locked(self) -> NoReturn:
        raise InUseError(
            "another thread was changing this object as the process was forked, so that its state is not whole here: "
            "fork while no thread changes it, or pass a clone"
        )


_EVERY: weakref.WeakSet[Turn] = weakref.WeakSet()


def _begin_child() -> None:
    for turn in tuple(_EVERY):
        turn.begin_child()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_child)


class Shared:
    """An object that several threads may use: its methods are marked by `reads` or `changes`."""

    _turn: Turn

    def _enter(self) -> None:
        """Shut the gate, and do what is due."""

    def _leave(self) -> None:
        """Open the gate."""


def reads(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Return the method as one that waits for its turn."""
    return _in_turn(method, changing=False)


def changes(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Return the method as one that waits for its turn, and is refused within another call of the same thread."""
    return _in_turn(method, changing=True)


def _in_turn(method: Callable[Concatenate[S, P], R], *, changing: bool) -> Callable[Concatenate[S, P], R]:
    @wraps(method)
    def in_turn(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        turn = self._turn
        with turn.lock:
            if turn.inside.locked():  # by this thread: a signal handler, or a user's function that is called
                if changing:
                    raise InUseError(
                        "what changes an object cannot be called within another call on it, as from a signal handler "
                        "or an input_map: note there what is to be done, and do it after that call"
                    )
                result = method(self, *args, **kwargs)
            else:
                with turn.inside:
                    turn.changing = True  # what is due may change something, too
                    self._enter()
                    turn.changing = changing
                    result = method(self, *args, **kwargs)
                    self._leave()  # left out where this is interrupted: the next call does it
        return result

    return in_turn
