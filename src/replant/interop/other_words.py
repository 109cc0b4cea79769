"""Words of other tools for an argument, answered with those of replant."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from difflib import get_close_matches
from typing import ParamSpec, TypeVar

from replant.errors import ArgumentTypeError, shown

P = ParamSpec("P")
R = TypeVar("R")

POLES = "poles=2 is the number of poles"
ZEROS = "zeros=1 is the number of zeros"
DELAY = "delay=0.2 is the dead time in s, samples times dt"
CLOCK = "dt=0.1 is the sampling time in s"
SEARCH = "search(log, poles=range(1, 4)) chooses the structure"
REST = "the initial state is estimated; fit(rp.from_rest(log), ...) takes it as at rest"
LOG = "fit(u, y, dt, poles=2), or fit(frame, input='u', output='y', poles=2)"

#: MATLAB and CONTSID, SIPPY, SysIdentPy, python-control.
WORDS = {
    **dict.fromkeys(("na", "np", "nf", "n", "order", "ylag", "n_poles", "na_ord", "ss_order"), POLES),
    **dict.fromkeys(("nz", "n_zeros"), ZEROS),
    **dict.fromkeys(("nb", "xlag", "nb_ord"), f"{ZEROS}, one less than nb, the number of coefficients"),
    **dict.fromkeys(("nk", "theta", "iodelay", "ioDelay", "InputDelay", "Td", "deadtime", "dead_time"), DELAY),
    **dict.fromkeys(("Ts", "ts", "T", "tsample", "sampling_time", "sample_time"), CLOCK),
    **dict.fromkeys(("fs", "Fs", "rate"), f"{CLOCK}, 1 / fs"),
    **dict.fromkeys(("nc", "nd"), "the noise model needs no order: it is chosen by the method"),
    **dict.fromkeys(("na_range", "order_range", "IC", "nanbnk"), SEARCH),
    **dict.fromkeys(("x0", "InitialState", "InitialCondition", "initial_state"), REST),
    **dict.fromkeys(("IO", "X", "data", "df"), LOG),
}


def in_our_words(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function so that an argument it does not have is answered in one line.

    Examples
    --------
    >>> @in_our_words
    ... def fit(poles: int = 1) -> int:
    ...     return poles
    >>> try:
    ...     fit(order=2)
    ... except ArgumentTypeError as error:
    ...     print(error)
    there is no argument 'order': poles=2 is the number of poles
    """
    known = tuple(name for name in inspect.signature(function).parameters if name != "self")

    @functools.wraps(function)
    def checked(*arguments: P.args, **named: P.kwargs) -> R:
        unknown = next((name for name in named if name not in known), None)
        if unknown is not None:
            raise ArgumentTypeError(f"there is no argument {shown(unknown)}: {_answer(unknown, known)}")
        return function(*arguments, **named)

    return checked


def _answer(name: str, known: tuple[str, ...]) -> str:
    """Return what to write in place of a word.

    Examples
    --------
    >>> _answer("pole", ("poles", "zeros")), _answer("magic", ("poles", "zeros"))
    ('poles is one', 'there are poles, zeros')
    """
    if name in WORDS:
        return WORDS[name]
    near = get_close_matches(name, known, n=1)
    return f"{near[0]} is one" if near else f"there are {', '.join(known)}"
