"""One call of the public API with hostile arguments: a result, or one line of ours that names the argument.

``python -m fuzz --what calls --tries 5000`` makes them by the thousand; ``python -m fuzz.calls NUMBER`` shows one.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import resource
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

import replant as rp
from fuzz.hostile import hostile
from fuzz.looks import looked_at
from fuzz.public import FUNCTIONS, classes, folder
from fuzz.trial import FindingError
from replant.errors import LONGEST

mpl.use("Agg")
MOST_MEMORY = 2**31  # bytes more than before that one call may ask for
#: What else an argument is called.
ALSO = {"log": ["u "], "input": ["column"], "output": ["column"], "time": ["column"]}
DEFECT = (AssertionError, MemoryError, KeyboardInterrupt)


def trial(number: int) -> str:
    """Make one call, the ``number``-th; return "result" or "refused".

    Raises
    ------
    FindingError
        With what happened.
    """
    chance = random.Random(number)
    _, function, given, replaced = _drawn(chance)
    steps = 0
    try:
        with contextlib.chdir(folder()), watched(), limited(MOST_MEMORY):
            got = function(**given)
            steps = 1
            acts = looked_at(got)
            for act in chance.sample(acts, min(3, len(acts))):
                act()
    except rp.ReplantError as error:
        check_message(error, replaced if steps == 0 and len(replaced) == 1 else ())
        return "refused"
    except Exception as error:
        if type(error).__name__ == "NotFittedError":  # what scikit-learn asks of its estimators
            return "refused"
        raise FindingError(f"{type(error).__name__} from {place(error)}") from error
    return "result"


def place(error: Exception) -> str:
    """The last line of ours that an error passed."""
    lines = [f"{Path(f.filename).name}:{f.lineno}" for f in traceback.extract_tb(error.__traceback__)]
    ours = [
        line
        for line, f in zip(lines, traceback.extract_tb(error.__traceback__), strict=True)
        if "/replant/" in f.filename
    ]
    return (ours or lines)[-1]


def _drawn(chance: random.Random) -> tuple[str, Callable[..., Any], dict[str, Any], list[str]]:
    """Draw a call and the arguments that are replaced, mostly one."""
    made, functions = classes(), list(FUNCTIONS.items())
    name, make = chance.choice(made if chance.random() < 0.5 else functions)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        function, ordinary = make()
        ordinary = dict(ordinary)
        replaced = chance.sample(list(ordinary), min(len(ordinary), chance.choice([1, 1, 1, 2, 3])))
        mild = chance.random() < 0.6
        given = {**ordinary, **{each: hostile(ordinary[each], chance, mild=mild) for each in replaced}}
    return name, function, given, replaced


def check_message(error: Exception, replaced: Any = ()) -> None:
    """Raise FindingError where a message is not one line that a user can act upon."""
    text = str(error)
    if not text or "\n" in text:
        raise FindingError(f"not one line: {type(error).__name__} {text!r:.200}") from error
    if len(text) > LONGEST:
        raise FindingError(f"{len(text)} characters: {text:.100}") from error
    if not isinstance(
        error, ValueError | TypeError | rp.SystemRefusedError | rp.MissingDependencyError | rp.CheckpointError
    ):
        raise FindingError(f"a {type(error).__name__}: {text:.150}") from error
    words = [word for each in replaced for word in (each, *ALSO.get(each, ()))]
    if isinstance(error, rp.ArgumentTypeError) and words and not any(word in text for word in words):
        raise FindingError(f"it does not name {replaced[0]}: {text:.150}") from error


@contextlib.contextmanager
def watched() -> Iterator[None]:
    """Let every warning be an error, but for those that are promised."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "the gbt filter rings")
        warnings.filterwarnings("ignore", "A column-vector y was passed")  # what scikit-learn asks of its estimators
        yield


@contextlib.contextmanager
def limited(more: int) -> Iterator[None]:
    """Let the process have so many bytes more of address space, and no more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:  # noqa: PTH123 - no file, but the kernel's word
        now = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (now + more if hard < 0 else min(now + more, hard), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def told(number: int) -> str:
    """A call in words."""
    name, _, given, replaced = _drawn(random.Random(number))
    shown = ", ".join(f"{each}={_shown(given[each])}" for each in replaced)
    return f"{name}: {shown}"


def _shown(value: Any) -> str:
    try:
        text = repr(value)
    except ValueError:  # a number of more digits than Python prints
        text = f"an {type(value).__name__} of {value.bit_length()} bits"
    about = f" {value.dtype} {value.shape}" if isinstance(value, np.ndarray | np.generic) else ""
    return f"{type(value).__name__}{about} {text:.150}"


if __name__ == "__main__":
    for each in map(int, sys.argv[1:]):
        print(each, told(each))
        try:
            print("   ", trial(each))
        except FindingError as error:
            print("   ", f"{error}"[:300])
            if error.__cause__ is not None:
                traceback.print_tb(error.__cause__.__traceback__)
