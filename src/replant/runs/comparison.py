"""Comparison: the same record through several methods, online and offline."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from replant.arguments import FloatArray, one_of
from replant.errors import ReplantError
from replant.offline.fit import FitResult, fit
from replant.optimizers import OPTIMIZERS
from replant.runs.run import Result, result_of_fit, run_online
from replant.settings import AUTO, Request

DEFAULT = "default"
OFFLINE = ("srivc", "least_squares")
#: What can be compared: replant's default, every optimizer, and the fits of the whole record.
METHODS = (DEFAULT, *OPTIMIZERS, *OFFLINE)
#: What is compared where nobody says: the default beside the article's methods and the whole record at once.
USUAL = (DEFAULT, "amsgrad", "gradient", *OFFLINE)
TRIAL = 500
"""Samples of a trial run [samples]."""


@dataclass(frozen=True, eq=False)
class Contender:
    """What one method made of the record.

    Attributes
    ----------
    name : str
        Of the method.
    result : Result or None
        None where the method found no model.
    fitted : FitResult or None
        Of an offline method.
    problem : str
        Why there is no result.
    """

    name: str
    result: Result | None
    fitted: FitResult | None = None
    problem: str = ""


def compare(
    request: Request,
    u: FloatArray,
    y: FloatArray,
    methods: Sequence[str] = USUAL,
    progress: Callable[[str, float], None] = lambda name, part: None,
) -> list[Contender]:
    """Identify the same record by each of ``methods``; one that fails does not keep the others from it.

    Parameters
    ----------
    request : Request
        Structure, sampling time and preprocessing; its optimizer is passed over.
    u, y : (K,) arrays
        Raw input and output.
    methods : sequence of str
        From `METHODS`.
    progress : callable
        Called with the method's name and how much of its work is done, up to 1.

    Examples
    --------
    >>> import numpy as np
    >>> from replant import Structure, TransferFunction
    >>> u = np.where(np.arange(2000) // 50 % 2 == 0, 1.0, -1.0)
    >>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    >>> for found in compare(Request(Structure(poles=1), 0.1), u, y, ["default", "srivc"]):
    ...     print(found.name, found.result.transfer_function)
    default 2 / (s + 0.5)
    srivc 2 / (s + 0.5)
    """
    contenders = []
    for name in methods:
        name = one_of("method", name, METHODS)
        with contextlib.suppress(ReplantError):  # what is loaded at a first call is not the method's time
            _identify(name, request, u[:TRIAL], y[:TRIAL], progress)
        try:
            contenders.append(_identify(name, request, u, y, progress))
        except ReplantError as problem:
            contenders.append(Contender(name, None, problem=str(problem)))
        progress(name, 1.0)
    return contenders


def _identify(
    name: str, request: Request, u: FloatArray, y: FloatArray, progress: Callable[[str, float], None]
) -> Contender:
    if name in OFFLINE:
        begun = time.perf_counter()
        fitted = fit(u, y, request.dt, request.structure, method=name, preprocess=request.preprocess)
        return Contender(name, result_of_fit(fitted, u, y, begun), fitted)
    request = dataclasses.replace(request, optimizer=AUTO if name == DEFAULT else name)
    return Contender(name, run_online(request, u, y, lambda done: progress(name, done / u.size)))


def best(contenders: Sequence[Contender]) -> Contender | None:
    """Return the contender whose model, run from the input alone, is closest to the output; None of none."""
    known = [(entry.result.simulation.fit, entry) for entry in contenders if entry.result is not None]
    usable = [(fit, entry) for fit, entry in known if fit > float("-inf")]
    return max(usable, key=lambda pair: pair[0])[1] if usable else None
