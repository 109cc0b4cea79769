"""Turns: calls on one object from any thread run one after the other, and an interrupt leaves none half done.

A call holds a lock during its turn.  Locking at each single sample would take longer than the sample: the kernel for
single samples checks a gate instead, one number that compiled code reads (`replant.kernels.native`), and the call waits
for its turn only if the gate is shut.

A signal handler runs in the main thread between any two bytecodes, and may raise, as Ctrl-C does.  The interpreter
acquires and releases the lock of a ``with`` in C, so that no lock stays held.  To leave a whole state, a call works on
a copy, and assigns it in one step (`Identifier._as_one`).
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
    """The locks of one object: ``lock`` is the turn of a thread; ``inside`` detects a call within a call."""

    def __init__(self) -> None:
        self.lock: Any = threading.RLock()
        self.inside: Any = threading.Lock()
        self.changing = False  # whether the call that entered last may change something
        _EVERY.add(self)

    def begin_child(self) -> None:
        """In a forked process, release the lock of a thread that is missing there; refuse a state it was changing."""
        if self.lock.acquire(blocking=False):  # free, or held by the thread that forked
            self.lock.release()
            return
        torn = self.changing and self.inside.locked()
        self.lock, self.inside = threading.RLock(), _Torn() if torn else threading.Lock()


class _Torn:
    """Replaces ``inside`` if another thread was changing the object when the process forked."""

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
    """An object that several threads may use; its methods are decorated with `reads` or `changes`."""

    _turn: Turn

    def _enter(self) -> None:
        """Shut the gate, and do the work due."""

    def _leave(self) -> None:
        """Open the gate."""


def reads(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Decorate a method to wait for its turn."""
    return _in_turn(method, changing=False)


def changes(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Decorate a method to wait for its turn, and to be refused within another call of the same thread."""
    return _in_turn(method, changing=True)


def _in_turn(method: Callable[Concatenate[S, P], R], *, changing: bool) -> Callable[Concatenate[S, P], R]:
    @wraps(method)
    def in_turn(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        turn = self._turn
        with turn.lock:
            if turn.inside.locked():  # by this thread: a call from a signal handler or from a user's function
                if changing:
                    raise InUseError(
                        "what changes an object cannot be called within another call on it, as from a signal handler "
                        "or an input_map: note there what is to be done, and do it after that call"
                    )
                result = method(self, *args, **kwargs)
            else:
                with turn.inside:
                    turn.changing = True  # the work due may change something, too
                    self._enter()
                    turn.changing = changing
                    result = method(self, *args, **kwargs)
                    self._leave()  # not reached if interrupted: the next call does it
        return result

    return in_turn
