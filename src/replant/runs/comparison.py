"""Comparison of methods, online and offline, on the same record."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from replant.arguments import FloatArray, one_of
from replant.errors import ReplantError
from replant.offline.fit import fit
from replant.offline.fit_result import FitResult
from replant.optimizers import OPTIMIZERS
from replant.runs.result import Result, result_of_fit
from replant.runs.run import run_online
from replant.settings import AUTO, Request

DEFAULT = "default"
OFFLINE = ("srivc", "least_squares")
#: What can be compared: replant's default, every optimizer, and the fits of the whole record.
METHODS = (DEFAULT, *OPTIMIZERS, *OFFLINE)
#: What is compared by default: replant's default, two of the article's optimizers, and the fits of the whole record.
USUAL = (DEFAULT, "amsgrad", "gradient", *OFFLINE)
TRIAL = 500  # samples of a trial run [samples]


@dataclass(frozen=True, eq=False)
class Contender:
    """The result of one method.

    Attributes
    ----------
    name : str
        Name of the method.
    result : Result or None
        None if the method found no model.
    fitted : FitResult or None
        The fit of an offline method.
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
    reference: FloatArray | None = None,
    t: FloatArray | None = None,
) -> list[Contender]:
    """Identify the same record by each of ``methods``; a method that fails is reported, and the others go on.

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
        r = reference if _uses_reference(name, request) else None
        with contextlib.suppress(ReplantError):  # a trial run first: loading kernels is not the method's time
            first_r, first_t = (None if signal is None else signal[:TRIAL] for signal in (r, t))
            _identify(name, request, u[:TRIAL], y[:TRIAL], first_r, first_t, progress)
        try:
            contenders.append(_identify(name, request, u, y, r, t, progress))
        except ReplantError as problem:
            contenders.append(Contender(name, None, problem=str(problem)))
        progress(name, 1.0)
    return contenders


def _uses_reference(name: str, request: Request) -> bool:
    return name == "srivc" if name in OFFLINE else _online(name, request).takes_reference


def _online(name: str, request: Request) -> Request:
    return dataclasses.replace(request, optimizer=AUTO if name == DEFAULT else name)


def _identify(
    name: str,
    request: Request,
    u: FloatArray,
    y: FloatArray,
    r: FloatArray | None,
    t: FloatArray | None,
    progress: Callable[[str, float], None],
) -> Contender:
    if name in OFFLINE:
        begun = time.perf_counter()
        more: dict[str, Any] = {} if r is None else {"reference": r}
        fitted = fit(
            u,
            y,
            request.dt,
            request.structure,
            method=name,
            preprocess=request.preprocess,
            filter=request.filter,
            t=t,
            **more,
        )
        return Contender(name, result_of_fit(fitted, u, y, begun, t), fitted)
    request = _online(name, request)
    return Contender(name, run_online(request, u, y, lambda done: progress(name, done / u.size), reference=r, t=t))


def best(contenders: Sequence[Contender]) -> Contender | None:
    """Return the contender with the best simulated fit; None if no contender has a model."""
    known = [(entry.result.simulation.fit, entry) for entry in contenders if entry.result is not None]
    usable = [(fit, entry) for fit, entry in known if fit > float("-inf")]
    return max(usable, key=lambda pair: pair[0])[1] if usable else None
