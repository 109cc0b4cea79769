"""One step test through `replant.search` and `replant.fit`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

import replant as rp
from replant.errors import ReplantError
from replant.signals import random_steps
from steps.cases import CASES, Case, Test, drawn, explained, nats_apart, response

RIGHT = 95.0  # %
FOUND = 2.0  # sampling times by which a dead time may be off
NEAR, SIGMAS = 0.1, 3.0  # of a coefficient that is known
LONG, STRUCTURES = 2400, 42  # of the search that is timed


@dataclass(frozen=True)
class Way:
    """What a way of identification gave.

    Attributes
    ----------
    poles, zeros : int
        0 where there is no model.
    delay_off : float
        Error of the dead time in sampling times; infinite where there is no model.
    fit : float
        Of the output without noise, in percent.
    known : bool
        Whether every coefficient is within 10 % and three standard deviations; of the right structure alone.
    status : str
        The verdict.
    seconds : float
        Processor time, that of the verdict included.
    """

    poles: int
    zeros: int
    delay_off: float
    fit: float
    known: bool
    status: str
    seconds: float

    @property
    def is_right(self) -> bool:
        """Whether it explains the output, or every coefficient is known."""
        return self.known or self.fit >= RIGHT

    @property
    def is_trusted(self) -> bool:
        """Whether its verdict is so."""
        return self.status == "trusted"


@dataclass(frozen=True)
class Outcome:
    """What came of one test.

    Attributes
    ----------
    case, number : int
    what : str
    nats : float
        See `nats_apart`; 0 in the textbook case.
    searched, fitted : Way
        By the search, and by `fit` with the right structure.
    problem : str
        Why the search gave nothing.
    """

    case: int
    number: int
    what: str
    nats: float
    searched: Way
    fitted: Way
    problem: str = ""

    @property
    def is_order_right(self) -> bool:
        """Whether the search has chosen the plant's number of poles."""
        return self.searched.poles == CASES[self.case].poles

    @property
    def is_delay_found(self) -> bool:
        """Whether the dead time is within two sampling times."""
        return abs(self.searched.delay_off) <= FOUND


def carry_out(seed: int, task: tuple[int, int, int]) -> Outcome:
    """Search and fit one step test: case, number, and samples of the textbook case or 0."""
    warm_up()
    case, number, samples = task
    of, test = CASES[case], drawn(seed, case, number, samples or None)
    grid = {"poles": (1,), "zeros": (0,)} if samples else {"poles": (1, 2, 3)}
    searched, problem = way(of, test, lambda: rp.search(test.u, test.y, of.dt, delays=of.delays, **grid).best)
    structure = rp.Structure(of.poles, 0, of.plant.delay)
    fitted, _ = way(of, test, lambda: rp.fit(test.u, test.y, of.dt, structure))
    nats = 0.0 if samples else nats_apart(of, test)
    return Outcome(case, number, test.what, nats, searched, fitted, problem)


def way(of: Case, test: Test, find: Callable[[], rp.FitResult]) -> tuple[Way, str]:
    """Return what a function finds, and the problem where it finds nothing."""
    begun = time.process_time()
    try:
        found = find()
        status = found.verdict.status
    except ReplantError as error:
        seconds = time.process_time() - begun
        return Way(0, 0, math.inf, -100.0, False, "no model", seconds), str(error)
    seconds = time.process_time() - begun
    structure, fit = found.structure, explained(test, found.transfer_function, of.dt)
    off = (structure.delay - of.plant.delay) / of.dt
    known = is_known(found, of.plant) and abs(off) <= FOUND
    return Way(structure.poles, structure.zeros, off, fit, known, status, seconds), ""


def is_known(fitted: rp.FitResult, plant: rp.TransferFunction) -> bool:
    """Return whether every coefficient is within 10 % and three standard deviations."""
    truth = np.concatenate([plant.den[1:], plant.num])
    if fitted.parameters.size != truth.size:
        return False
    off = np.abs(fitted.parameters - truth)
    std = fitted.uncertainty.std if fitted.uncertainty else np.full(off.size, math.inf)
    return bool((off <= NEAR * np.abs(truth)).all() and (off <= SIGMAS * std).all())


@cache
def warm_up() -> None:
    """Import what is imported at its first use, once a process."""
    of, u = CASES[0], random_steps(300, shortest=5, longest=40, low=-1.0, high=1.0, seed=1)
    y = response(of.plant, u, of.dt) + 0.1 * np.random.default_rng(1).standard_normal(u.size)
    assert rp.search(u, y, of.dt, poles=(1,), delays=(3.0,)).best.verdict.reasons


def long_search(seed: int) -> tuple[float, str]:
    """Return the processor time of a search over 42 structures, and what it found."""
    warm_up()
    of = CASES[3]
    u = random_steps(LONG, shortest=5, longest=60, low=-1.0, high=1.0, seed=seed)
    clean = response(of.plant, u, of.dt)
    y = clean + 0.05 * clean.std() * np.random.default_rng(seed).standard_normal(LONG)
    begun = time.process_time()
    found = rp.search(u, y, of.dt, poles=(1, 2, 3), delays=of.delays)
    assert len(found.candidates) == STRUCTURES
    structure = found.best.structure
    return time.process_time() - begun, (
        f"{structure.poles} poles, {structure.zeros} zeros, dead time {structure.delay:.3g} s"
        f" for {of.poles}, 0 and {of.plant.delay:g} s"
    )
