"""The kernels compiled and as plain Python: the same bits, on every kernel, and every function of theirs is reached."""

from __future__ import annotations

import dataclasses
import functools
import sys
from collections.abc import Callable
from types import CodeType
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.state import State, step_kernels
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from replant.kernels.filters import autoregressions, bank, chain
from replant.kernels.filters.autoregressions import fill_all_pole, fill_play
from replant.kernels.filters.reference import functions
from replant.kernels.filters.sums import explain, since_each
from replant.kernels.monitoring import interruptions, scatter
from replant.kernels.native import KERNELS, Kernel, interpreted
from replant.kernels.schema import DOUBTED, INPUT, LAGS, LAGUERRE, OUTPUT, STEP, Doubt
from replant.kernels.step.bank import weigh
from replant.kernels.step.miso import REFUSED, branch, learn
from replant.kernels.step.soundness import is_sound
from replant.kernels.step.stages import regressors, unroll, variance
from replant.model.transfer_function import TransferFunction
from replant.numerics import autoregression, linear_algebra
from replant.numerics.arguments import FloatArray
from support.cases import every
from support.places import ROOT

DT, BEGIN, SAMPLES = 0.02, 700, 160
PLANT = TransferFunction([8.0, 40.0], [1.0, 3.0, 25.0])
TWO = rp.Structure(poles=2, zeros=1)
FIXED = {"filter": rp.StateVariableFilter(10.0), "scaling": None, "instruments": False}
OPTIMIZERS = {
    "Gradient": rp.Gradient(5.0),
    "Adam": rp.Adam(0.01),
    "AMSGrad": rp.AMSGrad(0.01),
    "AdaGrad": rp.AdaGrad(0.1),
    "RMSProp": rp.RMSProp(0.001),
    "NAdam": rp.NAdam(0.01),
    "AdaDelta": rp.AdaDelta(),
    "IntegralCost": rp.IntegralCost(1.0, 0.1),
}
#: Settings of an identifier, by a name; with "stamps", "collecting" or "reference" in it the record is given so.
CASES: dict[str, dict[str, Any]] = {
    "default": {"structure": TWO},
    "default, stamps": {"structure": TWO},
    "no history": {"structure": TWO, "history": 0},
    "default, reference": {"structure": TWO},
    "dead time, stamps": {"structure": rp.Structure(poles=2, zeros=1, delay=0.05)},
    "dead time, reference": {"structure": rp.Structure(poles=2, zeros=1, delay=0.05)},
    "first-order hold": {"structure": TWO, "filter": rp.RefinedFilter(input_hold="foh")},
    "Kalman": {"structure": TWO, "optimizer": rp.KalmanTracking(process_noise=1e-3)},
    "forgetting": {"structure": TWO, "optimizer": rp.RecursiveLeastSquares(0.99)},
    "three poles, as many zeros": {"structure": rp.Structure(poles=3, zeros=3, feedthrough=True, bias=True)},
    "gradient, instruments": {"structure": TWO, "optimizer": "amsgrad", "instruments": True},
    "collecting": {"structure": TWO},
    "collecting, stamps, gradient": {"structure": TWO, "optimizer": "amsgrad", "instruments": True},
    **{
        f"fixed filter, {name}": {
            "structure": TWO, "optimizer": each, "replay": rp.Replay(capacity=40, batch_size=5), **FIXED,
        }
        for name, each in OPTIMIZERS.items()
    },
    "fixed filter, stamps": {"structure": rp.Structure(2, 1, bias=True), "optimizer": OPTIMIZERS["Adam"], **FIXED},
    "fixed filter, frozen, from rest": {"structure": rp.Structure(2, 1, bias=True), "optimizer": "adam", **FIXED},
}  # fmt: skip


def record(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return input, output, stamps and reference, with all that goes wrong in a record."""
    generator = np.random.default_rng(5)
    size = BEGIN + SAMPLES
    u = np.repeat(generator.choice([-1.0, 1.0], size // 10), 10)
    y = PLANT.simulate(u, DT) + 0.02 * generator.standard_normal(size)
    t = DT * np.arange(size) + 0.001 * generator.standard_normal(size)
    r = u + 0.1 * generator.standard_normal(size)
    wrong = BEGIN if "collecting" not in kind else 0
    y[wrong + 10 : wrong + 12] = 60.0
    y[wrong + 20] = u[wrong + 25] = np.nan
    u[wrong + 30] = 1e4
    r[wrong + 35] = np.inf
    y[wrong + 40 : wrong + 60] = y[wrong + 40]
    u[wrong + 62], y[wrong + 64] = 1e200, np.inf
    t[wrong + 70] = t[wrong + 69]
    t[wrong + 75] += 5.0
    t[wrong + 80] = np.inf
    t[wrong + 90 :] += 0.6
    t[wrong + 140 :] += 3.0
    t[wrong + 110] = 1e15
    t[wrong + 120 :] -= 2.0
    return u, y, t, r


def identified(kind: str) -> tuple[State, tuple[np.ndarray, ...], bool]:
    """Return a state under way, the samples that come next, and whether the clock is regular."""
    u, y, t, r = record(kind)
    stamps, reference = "stamps" in kind, "reference" in kind
    identifier = rp.Identifier(dt=DT, **CASES[kind])
    begin = BEGIN if "collecting" not in kind else 3
    more = {"t": t[:begin]} if stamps else {}
    more |= {"r": r[:begin]} if reference else {}
    identifier.update_many(u[:begin], y[:begin], **more)
    if "frozen" in kind:
        identifier._state.adapt = identifier._state.started = False
    nothing = np.zeros(0)
    samples = u[begin:], y[begin:], t[begin:] if stamps else nothing, r[begin:] if reference else nothing
    return identifier._state.copy(), tuple(part[:SAMPLES] for part in samples), not stamps


def run(kernel: Kernel, state: State, samples: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Let a kernel take all samples, whatever asks for attention meanwhile; return what it wrote."""
    size = samples[0].size
    errors, parameters = np.full(size, -7.0), np.full((size, 0 if state.collects else state.parameter_count), -7.0)
    taken = 0
    while taken < size:
        rest = [part[taken:] for part in samples]
        taken += kernel(*state.arrays, *rest, errors[taken:], parameters[taken:])
        state.attention = False
        state.held_at = max(state.held_at, 0)
    return (*state.arrays, errors, parameters)


def bits(arrays: tuple[Any, ...]) -> list[np.ndarray]:
    """Return arrays as they lie in memory, but that any NaN is as good as another."""
    return [np.where(np.isnan(each), np.nan, each).view(np.int64) for each in map(np.atleast_1d, arrays)]


def check(work: Callable[[], tuple[Any, ...]]) -> None:
    """Check that some work leaves the same bits compiled and interpreted."""
    compiled = work()
    with interpreted():
        plain = work()
    for one, other in zip(bits(compiled), bits(plain), strict=True):
        np.testing.assert_array_equal(one, other)


REACHED: set[CodeType] = set()


def once(compare: Callable[..., None]) -> Callable[..., None]:
    """Do a comparison that passes only once, and note the code of every function that it calls."""

    @functools.cache
    def noted(*given: Any) -> None:
        sys.setprofile(lambda frame, event, _: REACHED.add(frame.f_code) if event == "call" else None)
        try:
            compare(*given)
        finally:
            sys.setprofile(None)

    return noted


@once
def check_steps(kind: str) -> None:
    """Check the kernels that take samples."""
    state, samples, regular = identified(kind)
    one, many = step_kernels(state, regular=regular)
    check(lambda: run(many, state.copy(), samples))
    check(lambda: (float(is_sound(*state.arrays)),))

    def alone() -> tuple[Any, ...]:
        own = state.copy()
        stamp, reference = (part[0] if part.size else np.nan for part in samples[2:])
        return (*own.arrays, one(*own.arrays, samples[0][0], samples[1][0], stamp, reference))

    check(alone)


@once
def check_regressors() -> None:
    """Check the chain of filters alone, over a record."""
    state, (u, y, *_), _ = identified("default, reference")
    u, y = u[:60], y[:60]
    width = state.entries

    def work() -> tuple[Any, ...]:
        own, rows = state.copy(), np.zeros((2, u.size, width))
        target, output = np.zeros((2, u.size))
        regressors(*own.arrays, u, y, np.array([DT]), np.stack([u, y], 1), *rows, target, output)
        return (*own.arrays, rows, target, output)

    check(work)


@once
def check_branch() -> None:
    """Check a branch of a row: held or straight inputs, with and without a dead time, a model that is not stable."""
    u = np.append(np.random.default_rng(2).standard_normal(40), [np.nan, 0.5])
    for delay, hold, sign in ((0.0, "zoh", 1.0), (0.033, "zoh", 1.0), (0.033, "foh", 1.0), (0.0, "zoh", -1.0)):
        structure = rp.Structure(2, zeros=1, delay=delay)
        theta = np.array([sign, 2.0, 0.5, 1.0, 0.0, 0.3, 0.2])

        def work(structure: rp.Structure = structure, hold: str = hold, theta: FloatArray = theta) -> tuple[Any, ...]:
            model = AuxiliaryModel(structure, DT, hold)
            model.begin(theta)
            rows, output = np.zeros((u.size, model.entries)), np.zeros(u.size)
            branch(*model.arrays, u, np.array([DT]), structure.delay > 0.0, rows, output)
            return (*model.arrays, rows, output)

        check(work)


@once
def check_model() -> None:
    """Check what changes a model, stable or not, and what an interruption leaves."""
    state, _, _ = identified("default")
    for sign in (1.0, -1.0):

        def work(sign: float = sign) -> tuple[Any, ...]:
            own = state.copy()
            chain.install_model(*own.arrays, 1, sign * own.theta)
            own.elapsed = 1e9
            interruptions.interrupt(*own.arrays, 3.0)
            return own.arrays

        check(work)
    numbers = np.random.default_rng(1).standard_normal((3, 9))

    def denominator() -> tuple[Any, ...]:
        made = np.zeros(bank.size(3, 9))
        bank.set_denominator(made, 3, 9, 2, True, True, False, np.abs(numbers[0]), np.abs(numbers[1]))
        return (made,)

    check(denominator)


@once
def check_series() -> None:
    """Check the kernels on series of numbers."""
    generator = np.random.default_rng(2)
    noise = np.convolve(generator.standard_normal(300), [1.0, 0.8, 0.3])
    size = LAGS + 1
    lags = np.stack([np.roll(noise, lag) for lag in range(size)])

    def models() -> tuple[Any, ...]:
        found, variances = np.zeros((size, size)), np.zeros(size)
        order = autoregressions.nested_models(lags @ lags.T, 300.0, found, variances, np.zeros(size * size + size))
        model = np.zeros(size)
        power = scatter.autoregression((lags @ lags[0]).copy(), model, np.zeros(size))
        flat = np.zeros((size, size)), np.zeros(size)
        autoregressions.nested_models(np.zeros((size, size)), 300.0, *flat, np.zeros(size * size + size))
        return found, variances, float(order), model, power, *flat

    check(models)

    def filtered() -> tuple[Any, ...]:
        result, output = np.zeros((2, 50)), np.zeros(noise.size)
        fill_all_pole(np.array([1.0, -0.5, 0.2]), noise[:100].reshape(2, 50), result, np.zeros(3))
        fill_play(noise, 0.4, output)
        return result, output

    check(filtered)

    def whitened() -> tuple[Any, ...]:
        result, order = np.zeros(noise.size), 3
        orders = np.tril(np.cumsum(noise[: (order + 1) ** 2]).reshape(order + 1, order + 1))
        autoregressions.whiten_known(orders, noise[: order + 1], noise, 2, np.arange(noise.size // 2) % 5 - 1, result)
        return (result,)

    check(whitened)

    def summed() -> tuple[Any, ...]:
        sums, count = autoregression.sums_of(noise, np.arange(noise.size) % 40)
        parts, found = linear_algebra.sums_of_products(lags.T.copy(), np.array([50, 53])), np.empty(2)
        since_each(np.cumsum(parts[::-1], axis=0)[::-1].copy(), 2, found, np.empty((2 * LAGS, 2 * LAGS + 1)))
        left, error = lags.T.copy(), np.empty(noise.size)
        power = explain(left, 1, np.array([0.5, -0.25]), error)
        return parts, sums, float(count), found, left, error, power

    check(summed)

    def recent_ones() -> tuple[Any, ...]:
        ring, signals = noise[:300].reshape(50, 6).copy(), np.zeros((2, 40))
        ring[:, STEP], ring[:40, DOUBTED], ring[45, OUTPUT] = DT, float(Doubt.NONE), np.nan
        odd = [unroll(ring, end, DT, *signals) for end in (0, 30, 50)]
        return signals, *odd, *(variance(ring, end, 40, INPUT) for end in (0, 30, 50))

    check(recent_ones)

    def followed() -> tuple[Any, ...]:
        states, written = np.zeros((2, LAGUERRE)), np.zeros((50, 2 * LAGUERRE))
        functions(noise[:100].reshape(50, 2), np.array([0.5, 0.9]), states, written)
        return states, written

    check(followed)


@once
def check_row() -> None:
    """Check the joint update of a row, with a broken past, a missing output, and numbers that leave float64."""
    rows = np.random.default_rng(5).standard_normal((LAGS + 30, 4))
    rows[LAGS + 20] = 1e200
    measured, usual = np.arange(30) % 11 != 5, np.arange(30) % 7 != 3

    def work(instruments: FloatArray) -> tuple[Any, ...]:
        delta, factor, diagonal, squares = np.zeros(3), np.eye(3), np.full(3, 1e3), np.zeros(3)
        counts, errors, estimates = np.zeros(4, np.int64), np.zeros(30), np.zeros((30, 2))
        models, powers = np.tril(np.full((LAGS + 1, LAGS + 1), 0.3)), np.linspace(2.0, 1.0, LAGS + 1)
        alarm = learn(
            rows, instruments, measured.astype(np.int64), usual.astype(np.int64), True, 2, models, powers, delta,
            factor, diagonal, counts, squares, 1e-3, 2.0, errors, estimates, np.zeros(13),
        )  # fmt: skip
        assert counts[REFUSED] == 3  # as the noise model sees it in the two after it, too
        assert alarm < errors.size
        return delta, factor, diagonal, counts, squares, errors, estimates, np.array([alarm])

    check(functools.partial(work, np.zeros((0, 3))))
    check(functools.partial(work, np.random.default_rng(6).standard_normal((LAGS + 30, 3))))


@once
def check_bank() -> None:
    """Check the weights of a bank, with a member that takes no part, a sample that is missing, and outliers."""
    errors = np.random.default_rng(6).standard_normal((300, 3))
    errors[50, 1], errors[60], errors[200:210], errors[:, 2] = np.nan, 1e3, 1e2, np.nan

    def work() -> tuple[Any, ...]:
        size, weights, counts, logs = LAGS + 1, np.zeros(3), np.zeros(3, np.int64), np.zeros((300, 3))
        past, sums, models, variances = np.zeros((3, size)), *np.zeros((2, 3, size, size)), np.ones((3, size))
        models[:, :, 0], orders, numbers = 1.0, np.zeros(3, np.int64), np.zeros(1)
        weigh(
            errors, np.array([1, 1, 0]), 0.999, 1e-12, np.array([-1.0, -2.0, -3.0]), weights, past, sums, models,
            variances, orders, numbers, counts, logs, np.zeros(42),
        )  # fmt: skip
        return weights, past, sums, models, variances, orders, numbers, counts, logs

    check(work)


@once
def check_simulation(delay: float, straight: bool, regular: bool) -> None:
    """Check the simulation of a model."""
    from replant.model.state_space import Response

    u = np.random.default_rng(3).standard_normal(40)
    intervals = None if regular else DT * np.random.default_rng(4).uniform(0.5, 3.0, 40)

    def work() -> tuple[Any, ...]:
        model = dataclasses.replace(PLANT, delay=delay)
        response = Response(model, DT, "foh" if straight else "zoh", at_rest=regular)
        parts = [response.take(u[:15], None if regular else intervals[:15])]
        parts.append(response.take(u[15:], None if regular else intervals[15:]))
        return tuple(each for part in parts for each in (part.output, part.free, float(part.unknown)))

    check(work)


@every("kind", CASES)
def test_steps_leave_the_same_bits(kind: str) -> None:
    check_steps(kind)


def test_the_other_kernels_leave_the_same_bits() -> None:
    check_regressors()
    check_branch()
    check_model()
    check_series()
    check_row()
    check_bank()


@every("delay", [0.0, 0.033])
@every("straight", [False, True])
@every("regular", [False, True])
def test_simulations_leave_the_same_bits(delay: float, straight: bool, regular: bool) -> None:
    check_simulation(delay, straight, regular)


def test_every_function_that_is_translated_has_been_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """But those of lanes, which are compared with single members."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    from translator.program import Program, entry_kinds

    program = Program("replant.kernels", ROOT)
    for kernel in KERNELS:
        if kernel.python.__module__.startswith("replant.") and "ensemble" not in kernel.name:
            program.function(kernel.python, entry_kinds(kernel.python))
    for kind in CASES:
        check_steps(kind)
    check_regressors()
    check_branch()
    check_model()
    check_series()
    check_row()
    check_bank()
    check_simulation(0.033, False, False)
    check_simulation(0.033, True, True)
    missing = {function for function, _ in program.functions if function.__code__ not in REACHED}
    assert {f"{each.__module__}.{each.__name__}" for each in missing} == set()
