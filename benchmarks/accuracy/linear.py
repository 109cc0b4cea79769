"""Scenarios A, B, E and F, and A under coloured noise: constant plants, simulated."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import replant as rp
from accuracy.bounds import Bound
from accuracy.experiment import Experiment, Method, truth_of
from accuracy.information import cramer_rao
from accuracy.methods import Offline, Online
from accuracy.records import PLANT_A, PLANT_B, Excited, Irregular
from replant.estimation.filters import StateVariableFilter
from replant.estimation.optimizers import (
    OPTIMIZERS,
    Adam,
    AMSGrad,
    RecursiveLeastSquares,
)
from replant.signals import prbs

DEFAULT, OFFLINE, LEAST_SQUARES = "default", "offline SRIVC", "offline least squares"
BOTH: dict[str, Method] = {DEFAULT: Online(), OFFLINE: Offline()}

#: A: step size of the buffered optimizers, the same with and without instruments.
STEP_SIZE = 1e-3
#: J: RMSE beside the Cramer-Rao bound.
EFFICIENT = 1.15
OF_A, OF_B = rp.Structure(poles=2), rp.Structure(poles=4, zeros=1)
NAMES_A, NAMES_B = ("a1", "a0", "b0"), ("a3", "a2", "a1", "a0", "b1", "b0")
STD_A = dict(zip(NAMES_A, (0.11, 0.07, 0.05), strict=True))
STD_B = dict(zip(NAMES_B, (0.057, 0.95, 3.1, 7.4, 37.0, 75.0), strict=True))
STD_B_0DB = dict(zip(NAMES_B, (0.18, 3.0, 9.7, 24.0, 117.0, 238.0), strict=True))


def buffered(filter_: StateVariableFilter | None = None) -> dict[str, Method]:
    """Return buffered AMSGrad and Adam with and without instruments, behind a filter or behind the default one."""
    chosen = {} if filter_ is None else {"filter": filter_}
    behind = "" if filter_ is None else f", (s + {filter_.cutoff:g})^n"
    methods: dict[str, Method] = {}
    for name, optimizer in (("AMSGrad", AMSGrad(STEP_SIZE)), ("Adam", Adam(STEP_SIZE))):
        for instruments in (True, False):
            label = f"buffered {name}{behind}, {'with' if instruments else 'no'} instruments"
            methods[label] = Online({"optimizer": optimizer, "instruments": instruments, **chosen})
    return methods


def with_intervals(filter_: StateVariableFilter) -> dict[str, Method]:
    """Return the other methods that print an interval, every setting left to them but the filter of the buffered."""
    methods: dict[str, Method] = {
        "RLS, fixed filter, with instruments": Online(
            {"optimizer": RecursiveLeastSquares(), "filter": filter_, "instruments": True}
        ),
        "RLS, memory of 30 s": Online({"optimizer": RecursiveLeastSquares(time_constant=30.0)}),
        "Kalman tracking": Online({"optimizer": "kalman-tracking"}),
    }
    for name, optimizer in OPTIMIZERS.items():
        if not optimizer.keeps_covariance:
            methods[f"buffered {name}, with instruments"] = Online(
                {"optimizer": name, "filter": filter_, "instruments": True}
            )
    return methods


def same(names: tuple[str, ...], limit: float, **others: float) -> dict[str, float]:
    """Return one limit for every figure, but for the ``others``."""
    return dict.fromkeys(names, limit) | others


def scenario_a() -> Iterator[Experiment]:
    """2 / (s^2 + 4 s + 3), 0.05 s, 2001 samples, 10 dB."""
    article = StateVariableFilter(cutoff=2.0)
    inputs = {
        "prbs": ("PRBS of 8 bits, held 8 samples", 8, 8),
        "random": ("random binary, held 8 samples", 8, 0),
        "random-1": ("random binary, held 1 sample", 1, 0),
    }
    compared = buffered(article)
    bounds = (
        Bound(DEFAULT, "bias", same(NAMES_A, 2.0)),
        Bound(DEFAULT, "std", {name: 1.3 * std for name, std in STD_A.items()}),
        *(Bound(name, "bias", same(NAMES_A, 3.0)) for name in compared if "with instruments" in name),
    )
    for key, (words, hold, bits) in inputs.items():
        methods: Mapping[str, Method] = BOTH | {LEAST_SQUARES: Offline("least_squares")} | compared
        if key == "prbs":
            methods = methods | buffered() | with_intervals(article)
        yield Experiment(
            f"A {key}",
            f"2/(s^2+4s+3), {words}, 10 dB",
            OF_A,
            0.05,
            200,
            Excited(PLANT_A, 0.05, 2001, 10.0, hold, bits),
            methods,
            truth_of(PLANT_A, OF_A),
            bounds,
            covered=(DEFAULT, OFFLINE),
            shows_coverage=True,
            beside=key == "random-1",
        )


def scenario_coloured() -> Iterator[Experiment]:
    """A in first-order coloured noise: short, and ten times as long, where the recursion goes on by itself."""
    pure = RecursiveLeastSquares(time_constant=1e7)
    for colour in (0.5, 0.9):
        for samples, runs in ((2001, 200), (20_001, 60)):
            records = Excited(PLANT_A, 0.05, samples, 10.0, 8, 8, colour)
            u = prbs(samples, bits=records.bits, hold=records.hold)
            least = cramer_rao(PLANT_A, u, 0.05, records.decibels, colour).tolist()
            least_std = dict(zip(NAMES_A, least, strict=True))
            limits = {name: EFFICIENT * std for name, std in least_std.items()}
            yield Experiment(
                f"J pole-{colour:g} {samples}",
                f"2/(s^2+4s+3), PRBS, {samples} samples, 10 dB of noise with a pole at {colour:g}",
                OF_A,
                0.05,
                runs,
                records,
                BOTH | {"pure recursion: RLS, memory of 10^7 s": Online({"optimizer": pure})},
                truth_of(PLANT_A, OF_A),
                (Bound(DEFAULT, "rmse", limits),) if (colour, samples) == (0.9, 2001) else (),
                shows_coverage=True,
                least_std=least_std,
            )


def scenario_b() -> Iterator[Experiment]:
    """The Rao-Garnier system, PRBS of 10 bits held 7 samples, 0.01 s, 7161 samples."""
    title = "Rao-Garnier (-6400s+1600)/(s^4+5s^3+408s^2+416s+1600), PRBS of 10 bits, held 7 samples"
    cutoff = StateVariableFilter(cutoff=20.0)
    yield Experiment(
        "B 10dB",
        f"{title}, 10 dB",
        OF_B,
        0.01,
        200,
        Excited(PLANT_B, 0.01, 7161, 10.0, 7, 10),
        BOTH | {LEAST_SQUARES: Offline("least_squares")} | buffered(cutoff) | with_intervals(cutoff),
        truth_of(PLANT_B, OF_B),
        (
            Bound(DEFAULT, "bias", same(NAMES_B, 1.0, b0=3.0)),
            Bound(DEFAULT, "std", {name: 1.5 * std for name, std in STD_B.items()}),
        ),
        counted=100,
        covered=(DEFAULT, OFFLINE),
        shows_coverage=True,
    )
    yield Experiment(
        "B 0dB",
        f"{title}, 0 dB",
        OF_B,
        0.01,
        100,
        Excited(PLANT_B, 0.01, 7161, 0.0, 7, 10),
        BOTH | {LEAST_SQUARES: Offline("least_squares")},
        truth_of(PLANT_B, OF_B),
        (
            Bound(OFFLINE, "near", STD_B_0DB),
            Bound(OFFLINE, "standard errors", same(NAMES_B, 2.0)),
            Bound(DEFAULT, "bias", same(NAMES_B, 3.0, b0=10.0)),
        ),
    )


#: E: numerator, denominator, sampling time.
NOISE_FREE = {
    "1": ([1.25], [1.0, 0.5], 0.1),
    "2": ([2.0], [1.0, 4.0, 3.0], 0.05),
    "2-light": ([1.0], [1.0, 0.02, 100.0], 0.02),
    "2-integrator": ([2.0], [1.0, 3.0, 0.0], 0.05),
    "3": ([6.0], [1.0, 6.0, 11.0, 6.0], 0.05),
    "3-actuator": ([51.47, 7.722], [1.0, 3.292, 5891.0, 595.7], 0.005),
    "4": ([10.0, 24.0], [1.0, 10.0, 35.0, 50.0, 24.0], 0.05),
    "4-Rao-Garnier": ([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0], 0.01),
}


def scenario_e() -> Iterator[Experiment]:
    """Noise-free, PRBS of 10 bits held 7 samples, orders 1 to 4."""
    for key, (num, den, dt) in NOISE_FREE.items():
        plant, structure = rp.TransferFunction(num, den), rp.Structure(len(den) - 1, len(num) - 1)
        yield Experiment(
            f"E order-{key}",
            f"{plant}, PRBS, no noise".replace(" s", "s"),
            structure,
            dt,
            1,
            Excited(plant, dt, 2001, math.inf, 7, 10),
            BOTH,
            truth_of(plant, structure),
            (Bound(DEFAULT, "error", same(structure.names, 0.1)),),
        )


def scenario_f() -> Iterator[Experiment]:
    """A with 10 % of the samples dropped and 20 % of jitter, time stamps given."""
    inputs = {"prbs": ("PRBS of 8 bits, held 8 samples", 8, 8)} | {
        f"random-{hold}": (f"random binary, held {hold} sample{'s' * (hold > 1)}", hold, 0) for hold in (8, 4, 1)
    }
    readings = {"recorded": "u switches at recorded instants", "unseen": "u switches also at dropped instants"}
    for reading, what in readings.items():
        for key, (words, hold, bits) in inputs.items():
            yield Experiment(
                f"F {reading} {key}",
                f"A, 10 % dropped, 20 % jitter; {words}; {what}",
                OF_A,
                0.05,
                100,
                Irregular(hold, bits, switches_when_dropped=reading == "unseen"),
                BOTH,
                truth_of(PLANT_A, OF_A),
                (Bound(DEFAULT, "bias", same(NAMES_A, 2.0)),),
                beside=hold == 1,
            )
