"""Each row of docs/verdict.md beside two records: one where it is the cause, one that looks alike where it is not."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import replant as rp
from replant.estimation.engine.record import Record
from replant.fitting.miso_fit import fit_row
from replant.fitting.samples import Samples
from replant.kernels.filters.autoregressions import play
from replant.signals import multisine, random_steps
from replant.verdict import Verdict, assess_record
from replant.verdict.evidence import Evidence
from replant.verdict.other_columns import other_columns, with_other_columns
from replant.verdict.reasons import judge
from support.bending import lagging, rubbing, turning
from support.builders import binary
from support.cases import every
from support.loops import DT as LOOP_DT
from support.loops import Loop, coloured, controlled

TESTS = Path(__file__).parents[1]
PAGE = TESTS.parent / "docs" / "verdict.md"
ROWS = [line.split("|")[1].strip() for line in PAGE.read_text("utf-8").splitlines()
        if line.startswith("| ") and not line.startswith("| reason")]  # fmt: skip
DT, SAMPLES = 0.05, 3000
LAG, ONE, TWO = rp.TransferFunction([1.0], [1.0, 1.0]), rp.Structure(1), rp.Structure(2)
ZERO, BUMP = rp.TransferFunction([2.0, 6.0], [1.0, 1.0, 9.0]), rp.TransferFunction([0.3, 2.0], [1.0, 3.0, 2.0])
FAST = rp.TransferFunction([80.0], [1.0, 80.0])  # faster than 3 / DT
SLOW = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
Array = np.ndarray


def noise(seed: int, samples: int = SAMPLES) -> Array:
    return np.random.default_rng([seed, 7]).standard_normal(samples)


def steps(seed: int, samples: int = SAMPLES) -> Array:
    return random_steps(samples, shortest=5, longest=40, low=-1.0, high=1.0, seed=seed)


def out(u: Array, plant: rp.TransferFunction = LAG, part: float = 0.03, seed: int = 1, **how: Any) -> Array:
    """The output with noise, a part of it."""
    y = plant.simulate(u, DT, **how)
    return np.asarray(y + part * y.std() * noise(seed, y.size))


def run(u: Array, y: Array, structure: rp.Structure = ONE, t: Array | None = None, **options: Any) -> Verdict:
    ident = rp.Identifier(structure, DT, **options)
    ident.update_many(u, y, t)
    return ident.assess()


def finished(u: Array, y: Array) -> Verdict:
    ident = rp.Identifier(ONE, DT)
    ident.update_many(u, y)
    ident.finish()
    return ident.assess()


def fit(u: Array, y: Array, structure: rp.Structure = ONE, **options: Any) -> Verdict:
    return rp.fit(u, y, DT, structure, **options).verdict


def then(u: Array, samples: int, factor: float = 0.0) -> Array:
    """An input that goes on with the last value and a part of what it did before."""
    return np.append(u, u[-1] + factor * np.resize(u, samples))


def loop(
    seed: int, colour: float = 0.0, plant: rp.TransferFunction = LAG, echo: float = 0.0, gain: float = 2.0
) -> Loop:
    r = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, SAMPLES // 20), 20)
    white = coloured(seed, SAMPLES + 3, colour)
    return controlled(plant, r, 0.1 * (white[3:] - echo * white[:-3]), gain=gain)


def of_loop(found: Loop, r: Array | None = None, parameters: tuple[float, ...] = (1.0, 1.0)) -> Verdict:
    record = Record(found.u, found.y, np.array([LOOP_DT]), r=r)
    return assess_record(rp.Structure(len(parameters) - 1), np.array(parameters), record, LOOP_DT)


def of_model(parameters: tuple[float, ...], u: Array, y: Array, **how: Any) -> Verdict:
    return assess_record(
        rp.Structure(len(parameters) - 1), np.array(parameters), Record(u, y, np.array([DT])), DT, **how
    )


def opened() -> Loop:
    u = binary(1, SAMPLES, 5)
    return Loop(u, LAG.simulate(u, LOOP_DT) + 0.1 * coloured(1, SAMPLES, 0.0), u)


def acted(fault: Callable[[Array], Array], u: Array | None = None) -> Verdict:
    u = steps(1) if u is None else u
    return run(u, out(fault(u), SLOW), TWO)


def measured(fault: Callable[[Array], Array]) -> Verdict:
    """The verdict on a right plant whose output, of standard deviation one, is measured with a fault."""
    u = steps(1)
    y = SLOW.simulate(u, DT)
    return run(u, fault(y / y.std()) + 0.03 * noise(1), TWO)


def smooth() -> Array:
    return multisine(2 * SAMPLES, DT, np.geomspace(0.05, 2.0, 12), amplitude=0.4)


def sines() -> Array:
    """The input whose output hardly tells half a sample from a zero, under some noise."""
    t = DT * np.arange(1500)
    return np.asarray(np.sin(3.0 * t) + np.sin(1.3 * t + 1.0) + 0.5 * np.sin(0.4 * t))


def beside(made: Callable[[Array, Array], Array]) -> Verdict:
    """The verdict beside another column, of a record with a second input that is slower."""
    u, x = binary(1, SAMPLES, 8), binary(2, SAMPLES, 21)
    y = out(u) + 0.5 * LAG.simulate(x, DT)
    found = rp.fit(u, y, DT, ONE)
    record = Record(u, y, np.array([DT]))
    return with_other_columns(found.verdict, other_columns(ONE, found.parameters[:2], record, DT, {"x": made(x, y)}))


def several(share: float) -> Verdict:
    """The verdict on two inputs, beside a column that moves the output, too, as far as is said."""
    inputs, x = np.column_stack([steps(1), steps(2)]), steps(3)
    y = out(inputs[:, 0].copy()) + LAG.simulate(inputs[:, 1].copy(), DT) + share * LAG.simulate(x, DT)
    given = Samples.of(inputs, y, DT, None, None)
    return fit_row(replace(given, others={**given.others, "x": x}), (1, 1), (0, 0), (0.0, 0.0)).verdict


def changed(gain: float, *, more: int, load: float = 0.0) -> tuple[Array, Array]:
    """A gain that changes, or a load that comes, ``more`` samples before the end of 6,000."""
    u, since = binary(3, 6000, 8), np.arange(6000) >= 6000 - more
    y = LAG.simulate(u, DT) * np.where(since, gain, 1.0) + load * since
    return u, y + 0.05 * noise(3, 6000)


def by_schedule(size: float, period: float = 1.0) -> Verdict:
    """Of an input that is on for a part of each day, by other amounts, beside a wave of so many days."""
    days = DT * np.arange(SAMPLES) / 10.0
    u = np.where(days % 1.0 < 0.4, np.random.default_rng(4).uniform(0.8, 1.2, 16)[days.astype(int)], 0.0)
    y = LAG.simulate(u, DT) + size * np.sin(2.0 * np.pi * days / period + 1.0)
    return fit(u, y + 0.02 * noise(4))


def drifting(gain: float) -> tuple[Array, Array]:
    """A gain that grows steadily from one."""
    u = binary(3, 6000, 8)
    return u, LAG.simulate(u, DT) * np.linspace(1.0, gain, 6000) + 0.05 * noise(3, 6000)


def without(y: Array, samples: int) -> Array:
    return np.append(y[:-samples], np.full(samples, np.nan))


def stuck(y: Array, samples: int) -> Array:
    return np.append(y[:-samples], np.full(samples, y[-samples - 1]))


def coarse(y: Array, levels: int) -> Array:
    step = np.ptp(y) / levels
    return np.asarray(np.round(y / step) * step)


U = binary(1, SAMPLES, 20)
STEADY, TRUE = out(binary(1, 4000, 8), part=0.1), np.array([1.0, 1.0])


def held(std: float = 0.005, **changes: Any) -> Verdict:
    """The verdict on a right estimate that has not seen the last quarter, but for some changes."""
    record = Record(binary(1, 4000, 8), changes.pop("y", STEADY), np.array([DT]))
    covariance = changes.pop("covariance", np.diag((std * TRUE) ** 2))
    return judge(Evidence(ONE, DT, record, **{
        "estimate": TRUE, "covariance": covariance, "earlier": TRUE, "unseen": 1000, "learned": 3000, **changes
    }))  # fmt: skip


def solved(std: float) -> Verdict:
    off = {"estimate": TRUE * [1.3, 1.3], "earlier": TRUE * [1.3, 1.3]}
    return held(std, unseen=0, in_sample=True, finished=True, **off)


def after(sample: int, size: float, until: int = 4000) -> Array:
    index = np.arange(4000)
    return np.where((index >= sample) & (index < until), size, 0.0)


@functools.cache
def right() -> Verdict:
    """The verdict on a model of the right structure, of the right record."""
    return run(U, out(U))


@functools.cache
def rested() -> Verdict:
    """The verdict on a right model after its input has come to rest."""
    return run(then(U, 10_500), out(then(U, 10_500)))


@functools.cache
def constant() -> Verdict:
    return run(np.ones(SAMPLES), noise(1))


@functools.cache
def coarse_of_twelve() -> Verdict:
    return run(U, coarse(out(U, part=0.0), 12))


@functools.cache
def two_poles() -> Verdict:
    """The verdict on one pole where there are two."""
    return run(U, out(U, SLOW))


HELD = np.repeat(np.random.default_rng(5).uniform(-1.0, 1.0, SAMPLES // 40), 40)
GLITCHES = np.arange(SAMPLES) % 700 == 350
KEPT = np.arange(SAMPLES) % 60 < 54  # six rows in a row are lost, again and again
Pair = tuple[Callable[[], Verdict], Callable[[], Verdict]]
#: By the row: a record where it is the cause, and one that looks alike.
PAIRS: dict[str, Pair] = {
    "the input is constant": (
        constant,
        rested,
    ),
    "far from its others,": (
        lambda: fit(np.where(GLITCHES, 80.0, U), out(U)),
        lambda: fit(np.where(GLITCHES, 80.0, U), out(np.where(GLITCHES, 80.0, U), SLOW)),
    ),
    "the output drifts along a straight line,": (
        lambda: fit(U, out(U) + np.linspace(0.0, 30.0, SAMPLES)),
        lambda: fit(U + np.linspace(0.0, 3.0, SAMPLES), out(U + np.linspace(0.0, 3.0, SAMPLES), SLOW)),
    ),
    "the input has rested for the last": (
        rested,
        constant,
    ),
    "the input hardly moves any more": (
        lambda: run(then(U, 6000, 1e-3), out(then(U, 6000, 1e-3))),
        lambda: run(then(U, 6000, 0.1), out(then(U, 6000, 0.1), part=0.001)),
    ),
    "the input does not excite every coefficient": (
        lambda: fit(np.sin(DT * np.arange(SAMPLES)), np.sin(DT * np.arange(SAMPLES) - 1.0), rp.Structure(3, 2)),
        lambda: fit(U, out(U)),
    ),
    "the output is a copy of the input": (
        lambda: fit(U, 2.5 * U + 20.0),
        lambda: fit(U, out(U, FAST, part=0.0)),
    ),
    "the output has only": (
        lambda: run(out(U), U),
        lambda: run(U, coarse(out(U), 6)),
    ),
    "s apart where dt says": (
        lambda: run(U, out(U), t=0.1 * np.arange(SAMPLES)),
        lambda: run(U, out(U), t=DT * (np.arange(SAMPLES) + 0.2 * np.sin(np.arange(SAMPLES)))),
    ),
    "the time stamps have a gap every": (
        lambda: fit(U, out(U), t=DT * (np.arange(SAMPLES) // 5 * 5 + 0.02 * (np.arange(SAMPLES) % 5))),
        lambda: fit(U[KEPT], out(U)[KEPT], t=DT * np.flatnonzero(KEPT)),
    ),
    "the actuator seems to saturate": (
        lambda: acted(lambda u: np.clip(u, -0.4, 0.4)),
        lambda: acted(lambda u: u, np.clip(steps(1), -0.4, 0.4)),
    ),
    "the actuator seems to have a dead zone": (
        lambda: acted(lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.4, 0.0)),
        lambda: acted(lambda u: u, np.where(np.abs(steps(1)) > 0.4, steps(1), 0.0)),
    ),
    "the actuator seems to have another gain in the other direction": (
        lambda: acted(lambda u: np.where(u > 0.0, 1.5 * u, 0.5 * u)),
        lambda: acted(lambda u: u, np.where(steps(1) > 0.0, 1.5 * steps(1), 0.5 * steps(1))),
    ),
    "the actuator seems to have play or friction": (
        lambda: acted(lambda u: play(u, 0.4)),
        lambda: acted(lambda u: u, play(steps(1), 0.4)),
    ),
    "the sensor seems to saturate": (
        lambda: measured(lambda y: np.clip(y, -1.0, 1.0)),
        lambda: acted(lambda u: np.clip(u, -0.4, 0.4)),
    ),
    "the sensor seems to have a dead zone": (
        lambda: measured(lambda y: np.sign(y) * np.maximum(np.abs(y) - 0.3, 0.0)),
        lambda: acted(lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.4, 0.0)),
    ),
    "the sensor seems to have another gain in the other direction": (
        lambda: measured(lambda y: np.where(y > 0.0, 1.5 * y, 0.5 * y)),
        lambda: acted(lambda u: np.where(u > 0.0, 1.5 * u, 0.5 * u)),
    ),
    "the output is held from report to report": (
        lambda: fit(U, np.repeat(out(U)[::6], 6)),
        lambda: fit(U, np.round(out(U), 1)),
    ),
    "the plant acts otherwise at other levels: within those of the record G differs by x % at least": (
        lambda: fit(U, lagging(U, DT, lambda y: 0.4 * y)),
        lambda: fit(U, out(U)),
    ),
    "the plant acts otherwise on its way up than on its way down: G differs from the model by x % at least": (
        lambda: fit(HELD, turning(HELD, DT, 1.25, 0.8) + 0.01 * noise(1)),
        lambda: fit(HELD, out(HELD)),
    ),
    "the plant changes as the record goes on: G differs from the model by x % in the mean": (
        lambda: fit(U, out(U * (1.0 + 0.3 * np.sin(6.0 * np.pi * np.arange(SAMPLES) / SAMPLES)))),
        lambda: fit(U, out(U)),
    ),
    "the plant seems to have dry friction: without it a coefficient differs by x %": (
        lambda: fit(U, rubbing(U, DT, 1.0, 0.1) + 0.01 * noise(1), TWO),
        lambda: fit(U, rubbing(U, DT, 1.0, 0.0) + 0.01 * noise(1), TWO),
    ),
    "the input seems to run straight between its samples": (
        lambda: run(smooth(), out(smooth(), ZERO, input_hold="foh"), rp.Structure(2, 1)),
        lambda: run(smooth(), out(smooth(), ZERO), rp.Structure(2, 1)),
    ),
    "before its row: a coefficient differs by": (
        lambda: fit(HELD, np.append(out(HELD, part=0.2)[1:], 0.0)),
        lambda: fit(HELD, out(HELD, part=0.2)),
    ),
    "a disturbance that has the input's period": (
        lambda: by_schedule(0.06),
        lambda: by_schedule(0.06, period=1.7),  # the weather of another star
    ),
    "than the model says": (
        lambda: run(U, out(np.append(0.0, U)[:SAMPLES])),
        two_poles,
    ),
    "the loop is closed, and either its disturbances have more colour": (
        lambda: of_loop(loop(1, echo=0.9)),
        lambda: of_loop(opened()),
    ),
    "the loop is closed: the input answers the residual": (lambda: of_loop(loop(1)), lambda: of_loop(opened())),
    "the input answers the residual of the same sample": (
        lambda: fit(noise(3), out(noise(3)) + 0.5 * noise(3)),
        lambda: of_loop(opened()),
    ),
    "along with it, where a controller opposes it": (
        lambda: fit(noise(3), out(noise(3)) + 0.5 * noise(3)),
        lambda: fit(noise(3), out(noise(3)) - 0.5 * noise(3)),
    ),
    "the reference stands still": (
        lambda: of_loop(loop(4), np.ones(SAMPLES)),
        lambda: of_loop(loop(4), loop(4).r),
    ),
    "the reference is a copy of the input": (
        lambda: of_loop(loop(4), 2.0 * loop(4).u + 1.0),
        lambda: of_loop(loop(4), loop(4).r),
    ),
    "the reference explains nothing of the input": (
        lambda: of_loop(loop(4), coloured(9, SAMPLES, 0.5)),
        lambda: of_loop(loop(4), loop(4).r + 0.3 * coloured(9, SAMPLES, 0.5)),
    ),
    "the reference follows the disturbances": (
        lambda: of_loop(loop(4), loop(4).r - 0.5 * loop(4).y),
        lambda: of_loop(loop(4), loop(4).r),
    ),
    "the input could explain another x % of the output's power": (
        two_poles,
        lambda: run(U, out(U, part=0.5)),
    ),
    "which is no more than the uncertainty of the model allows": (
        lambda: held(0.2, estimate=TRUE * [1.0, 1.2], earlier=TRUE * [1.0, 1.2], adapts=False),
        lambda: held(0.005, estimate=TRUE * [1.0, 1.2], earlier=TRUE * [1.0, 1.2], adapts=False),
    ),
    "explains x % of what is left": (
        lambda: beside(lambda x, y: x),
        lambda: beside(lambda x, y: np.append(0.0, y[:-1])),
    ),
    "are input and output swapped?": (
        lambda: fit(out(U) + 0.05 * noise(5), U),
        lambda: fit(U, noise(5)),
    ),
    "the model explains almost nothing of the output": (
        lambda: run(U, noise(5)),
        lambda: run(U, out(U, part=1.5)),
    ),
    "the output is constant over": (
        lambda: fit(U, np.ones(SAMPLES)),
        lambda: fit(U, coarse(out(U), 3)),
    ),
    "the model's signals leave float64": (
        lambda: of_model((1.0, 1e250), U, out(U)),
        lambda: of_model((1.0, 1.0), U, out(U)),
    ),
    "only a reference can show that an unstable model is right": (
        lambda: of_loop(loop(2, 0.5, rp.TransferFunction([1.0], [1.0, -1.0]), gain=3.0), None, (-1.0, 1.0)),
        lambda: of_loop(loop(3, 0.0, rp.TransferFunction([1.0], [1.0, 0.0]), gain=1.0), None, (-0.0005, 1.0)),
    ),
    "the residual began to grow": (
        lambda: run(*changed(1.5, more=40)),
        lambda: run(*changed(1.0, more=40)),
    ),
    "the plant seems to have changed": (
        lambda: fit(*changed(1.4, more=3000)),
        lambda: fit(*changed(1.0, more=3000, load=1.0)),
    ),
    "the plant seems to change all along, or not to be linear": (
        lambda: fit(*drifting(2.0)),
        lambda: fit(*drifting(1.05)),
    ),
    "the estimate is that of the samples since": (
        lambda: run(*changed(1.5, more=3000)),
        lambda: run(*changed(1.0, more=3000, load=1.0)),
    ),
    "the output is constant to the bit": (
        lambda: run(U, stuck(out(U), 200)),
        coarse_of_twelve,
    ),
    ": a stuck or saturated sensor, a cable off, or friction": (
        lambda: run(U, stuck(out(U), 400)),
        coarse_of_twelve,
    ),
    "no output has arrived": (
        lambda: run(U, without(out(U), 200)),
        lambda: run(U, np.where(np.arange(SAMPLES) % 5 == 0, np.nan, out(U))),
    ),
    "a coefficient has a standard deviation of x %": (
        lambda: fit(U[:300], out(U[:300], part=3.0)),
        lambda: fit(U, out(U, part=0.5)),
    ),
    "may cancel the pole": (
        lambda: fit(U, out(U), rp.Structure(2, 1)),
        lambda: fit(U, out(U, SLOW), TWO),
    ),
    "the uncertainty of the estimate amounts to x % of the modelled output": (
        lambda: fit(U[:300], out(U[:300], part=3.0)),
        lambda: fit(U, out(U, part=0.5)),
    ),
    "too few for a verdict": (
        lambda: run(U[:90], out(U[:90]), startup=60),
        lambda: run(U[:400], out(U[:400]), startup=60),
    ),
    "too few to test it on": (
        lambda: run(U[:540], out(U[:540])),
        right,
    ),
    "the estimate has used every sample: none is left": (
        lambda: run(U[:500], out(U[:500])),
        right,
    ),
    "samples gives no usable model": (
        lambda: finished(U[:10], out(U[:10])),
        lambda: run(U[:10], out(U[:10])),
    ),
    "samples for the first model": (lambda: run(U[:90], out(U[:90])), lambda: run(U[:700], out(U[:700]))),
    "too few raw samples are kept to solve the record again, and to check": (
        lambda: run(U, out(U), history=0),
        lambda: run(U, out(U), history=1000),
    ),
    "too few raw samples are kept for a verdict, and this optimizer follows no sums": (
        lambda: run(U, out(U), history=0, optimizer="amsgrad"),
        lambda: run(U, out(U), history=0),
    ),
    "the model was trusted when the input came to rest": (
        rested,
        lambda: run(then(U[:300], 10_500), out(then(U[:300], 10_500), part=3.0)),
    ),
    "the model fits the output to x %": (right, lambda: run(U, noise(5))),
    "the samples do not tell a held input from one that runs straight between its samples": (
        lambda: run(sines(), out(sines(), BUMP, part=0.1), rp.Structure(2, 1)),
        lambda: run(sines(), out(sines(), BUMP, part=0.003), rp.Structure(2, 1)),
    ),
    "could explain a further x % of the output's power: make it an input, too": (
        lambda: several(0.5),
        lambda: several(0.0),
    ),
    "filtered by its noise model the same record gives another model, whose output differs by x %": (
        lambda: solved(0.005),
        lambda: solved(0.3),
    ),
    "unexplained by the estimate of": (lambda: held(earlier=TRUE * [1.5, 1.5]), lambda: held()),
    "the power of the residual has grown": (
        lambda: held(y=STEADY + after(3001, 0.3) * np.sin(2.1 * np.arange(4000))),
        lambda: held(y=STEADY + 0.3 * np.sin(2.1 * np.arange(4000))),
    ),
    "times its largest power over any earlier stretch": (
        lambda: held(y=STEADY + after(3960, 1.0)),
        lambda: held(y=STEADY + after(3960, 1.0) + after(3240, 1.0, 3280)),
    ),
    "since the plant has changed abs G is known to x % only": (
        lambda: held(0.1, after_change=True),
        lambda: held(0.1),
    ),
    "the residual had grown, and the samples since do not tell yet whether a load or the plant has changed": (
        lambda: held(undecided=True),
        lambda: held(),
    ),
    "updates left the range of float64": (lambda: held(refused=True), lambda: held()),
    "because the residual varies slowly": (lambda: held(0.2, slowness=10.0), lambda: held(0.2, slowness=2.0)),
    "a coefficient has moved by x %": (lambda: held(earlier=TRUE * [1.5, 1.5]), lambda: held(earlier=TRUE * 1.01)),
    "the samples give a coefficient that differs by x %": (
        lambda: held(earlier=TRUE * [1.3, 1.0], estimate=TRUE * [1.3, 1.0], adapts=False),
        lambda: held(earlier=TRUE * 1.01, estimate=TRUE * 1.01, adapts=False),
    ),
    "a pole is as fast as is looked for": (
        lambda: fit(steps(1), out(steps(1), FAST, 0.01)),
        lambda: fit(steps(1), out(steps(1), rp.TransferFunction([50.0], [1.0, 50.0]), 0.01)),
    ),
    "the present model is provisional": (lambda: run(U[:300], out(U[:300])), lambda: run(U[:700], out(U[:700]))),
    "the samples of the start-up spoke against the model that they gave": (
        lambda: run(U, out(U, rp.TransferFunction([9.0], [1.0, 0.6, 9.0]), 0.01), history=0),
        lambda: run(U, out(U), history=0),
    ),
}
#: Rows whose two records other tests have: the one where it is the cause, and the one that looks alike.
ELSEWHERE = {
    "alone would put abs G x % elsewhere": (
        "verdict/test_gain_error.py: test_a_change_near_the_end_of_a_long_record_is_found",
        "verdict/test_gain_error.py: test_the_truth_is_seldom_contradicted",
    ),
    "the residual is as usual again, but the samples since tell abs G": (
        "verdict/test_gravest_finding.py: test_after_an_alarm_nothing_is_trusted_before_the_gain_can_show",
    ),
    "rely on G(s) where the input excites it": (
        "verdict/test_gravest_finding.py: test_a_coefficient_that_is_known_badly_is_said_where_the_model_is_known_well",
    ),
    "lie exactly at an extreme of the output": (
        "verdict/test_reasons.py: test_an_output_that_is_cut_off_is",
        "verdict/test_reasons.py: test_an_encoder_that_turns_round_is_not_at_its_limit",
    ),
    "are constant to the bit: the end of the record is filled up": (
        "verdict/test_reasons.py: test_an_end_filled_up_with_zeros_is_named",
        "verdict/test_reasons.py: test_a_sensor_that_stays_where_it_was_fills_up_nothing",
    ),
    "outputs were left out: the sensor was stuck or at its limit": (
        "verdict/test_reasons.py: test_a_coarse_sensor_that_stands_still_while_the_model_moves_many_steps_is",
        "verdict/test_reasons.py: test_the_plateaus_of_a_coarse_sensor_are_not_stuck",
    ),
    "with fewer poles the record is likelier": (
        "fitting/test_fewer_poles.py: test_of_a_lag_one_pole_is_asked_for",
        "fitting/test_fewer_poles.py: test_of_the_right_order_no_fewer_poles_are_asked_for",
    ),
    "the inputs could explain a further x % of the output's power": (
        "fitting/test_several_inputs.py: test_a_pole_too_few",
    ),
    "another load acts since": (
        "fitting/test_loads.py: test_a_record_is_parted_at_its_loads",
        "fitting/test_loads.py: test_a_record_without_a_load_is_not_parted",
    ),
    "the initial state takes a part of the response to the first move of the input": (
        "fitting/test_initial_state.py: test_a_gain_that_rest_refutes_is_not_trusted",
        "fitting/test_initial_state.py: test_a_gain_that_rest_confirms_is_trusted",
    ),
    "another load may act since": (
        "fitting/test_loads.py: test_loads_that_are_likely_but_not_sure_take_trust_away",
        "fitting/test_loads.py: test_a_record_without_a_load_is_not_parted",
    ),
    "its response differs by x % from the estimate's": (
        "online/test_several_inputs.py: test_a_change_since_an_estimate_was_frozen_is_named",
        "online/test_several_inputs.py: test_a_plant_that_does_not_change_has_not_changed",
    ),
    "beside the others": (
        "fitting/test_inputs_of_rows.py: test_an_actuator_that_bends_its_input_is_named_beside_another_input",
        "fitting/test_inputs_of_rows.py: test_a_right_row_that_visits_many_levels_has_no_fault",
    ),
    "is a copy of the output, sample for sample": (
        "fitting/test_inputs_of_rows.py: test_an_input_that_a_gain_makes_of_the_output_is_no_wrong_column",
        "fitting/test_inputs_of_rows.py: test_an_output_that_is_an_input_is_a_wrong_column",
    ),
    "it acts at once, or its column is recorded late": (
        "fitting/test_inputs_of_rows.py: test_an_input_recorded_late_is_no_controller",
        "fitting/test_inputs_of_rows.py: test_a_right_row_has_no_fault",
    ),
    "answers to disturbances of the output: a controller makes it": (
        "fitting/test_several_inputs.py: test_a_controller_that_makes_an_input",
        "fitting/test_several_inputs.py: test_what_a_decimated_record_sees_ahead_is_no_controller",
    ),
    "does not move: move it, or leave it out": ("fitting/test_several_inputs.py: test_an_input_that_rests",),
    "no input has moved for the last": (
        "online/test_several_inputs.py: test_a_model_stays_trusted_while_all_inputs_rest_and_it_is_said",
    ),
    "move together as one signal": (
        "fitting/test_several_inputs.py: test_inputs_that_are_one_signal",
        "fitting/test_several_inputs.py: test_inputs_that_move_together_and_are_both_needed",
    ),
    "move together: their gains correlate by": (
        "fitting/test_several_inputs.py: test_inputs_that_move_together_and_are_both_needed",
    ),
    "could be left out, but not all of them": ("fitting/test_several_inputs.py: test_inputs_that_move_together",),
    "explains nothing of the output: leave it out": (
        "fitting/test_several_inputs.py: test_an_input_that_explains_nothing",
    ),
    "is moved by the reference: the estimate is made from what that explains of it": (
        "fitting/test_rows_in_feedback.py: test_with_a_reference_the_estimate_is_right_under_any_noise",
    ),
    "the reference explains nothing of any input": (
        "fitting/test_rows_in_feedback.py: test_a_reference_of_no_use_changes_no_estimate",
    ),
    "the structure leaves slow parts of the output": ("fitting/test_several_inputs.py: test_a_pole_too_few",),
    "a coefficient is known to x % only": (
        "fitting/test_several_inputs.py: test_a_slow_pole_in_slow_noise_is_not_known",
        "fitting/test_several_inputs.py: test_the_joint_covariance_is_that_of_the_errors",
    ),
    "the uncertainty of its transfer function amounts to x % of its part of the output": (
        "fitting/test_several_inputs.py: test_an_output_that_has_nothing_to_do_with_the_inputs_is_not_trusted",
        "fitting/test_several_inputs.py: test_a_row_without_noise_is_found_exactly",
    ),
    "another model is as likely, with another response to input": (
        "fitting/test_several_inputs.py: test_a_model_beside_which_others_are_as_likely_is_not_trusted",
        "fitting/test_several_inputs.py: test_three_inputs_with_zeros_are_told_apart",
    ),
    "an update has made a pole unstable": (
        "online/test_several_inputs.py: test_an_update_to_an_unstable_pole_is_named_and_solved_anew",
    ),
    "each input is told apart, and the inputs explain no more of the output": (
        "fitting/test_several_inputs.py: test_three_inputs_with_zeros_are_told_apart",
    ),
}
#: No record is known where they are said.
UNSHOWN = [
    "what the model leaves may be chance",
    "no input answers to disturbances: the reference is not needed",
    "the estimate made with the reference did not come to rest",
    "an update would have left float64",
]


def pieces(row: str) -> list[str]:
    return [piece.strip() for piece in re.split(r"x %", row) if piece.strip()]


def is_said(row: str, verdict: Verdict) -> bool:
    return any(all(piece in reason for piece in pieces(row)) for reason in verdict.reasons)


@every("row", PAIRS, quick=8)
def test_it_is_said_where_it_is_the_cause_and_not_where_it_looks_alike(row: str) -> None:
    cause, alike = (each() for each in PAIRS[row])
    assert is_said(row, cause), cause.reasons
    assert not is_said(row, alike), alike.reasons


def test_every_row_has_its_records() -> None:
    assert sorted([*PAIRS, *ELSEWHERE, *UNSHOWN]) == sorted(ROWS)


@every("row", ELSEWHERE)
def test_the_tests_elsewhere_are_there(row: str) -> None:
    for place in ELSEWHERE[row]:
        file, name = place.split(": ")
        tree = ast.parse((TESTS / file).read_text("utf-8"))
        assert name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}, place
