"""When the input acts: one that runs straight between its samples, and another dead time, are found out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.signals import multisine, random_steps
from support.cases import every
from support.loops import steps

PLANT, STRUCTURE = rp.TransferFunction([2.0, 6.0], [1.0, 1.0, 9.0]), rp.Structure(2, 1)
SAMPLES = 6000


def verdict(u: np.ndarray, dt: float, input_hold: str, seed: int, **options: object) -> rp.Assessment:
    """The verdict on a record whose input runs as ``input_hold`` says, with noise of 3 %."""
    y = PLANT.simulate(u, dt, input_hold=input_hold)
    y += 0.03 * y.std() * np.random.default_rng(seed).standard_normal(y.size)
    ident = rp.Identifier(STRUCTURE, dt, **options)  # type: ignore[arg-type]
    ident.update_many(u, y)
    return ident.assess()


def smooth(dt: float) -> np.ndarray:
    return multisine(SAMPLES, dt, np.geomspace(0.05, 2.0, 12), amplitude=0.4)


@every("dt", [0.1, 0.05], quick=1)
def test_a_smooth_input_taken_as_held_is_said(dt: float) -> None:
    found = verdict(smooth(dt), dt, "foh", seed=1)
    assert any("run straight between its samples" in reason for reason in found.reasons), found.reasons
    right = verdict(smooth(dt), dt, "foh", seed=1, filter=rp.RefinedFilter(input_hold="foh"))
    assert right.status == "trusted", right.reasons


@every("seed", range(4), quick=1)
def test_a_held_input_is_right_as_it_is(seed: int) -> None:
    """Whether it is smooth or not."""
    steps = random_steps(SAMPLES, shortest=5, longest=40, low=-1.0, high=1.0, seed=seed)
    for u in (smooth(0.1), steps):
        found = verdict(u, 0.1, "zoh", seed)
        assert found.status == "trusted", found.reasons
        assert not any("straight" in reason for reason in found.reasons)


@every("seed", range(6), quick=2)
def test_a_rough_input_that_runs_straight_is_not_taken_for_a_direct_path(seed: int) -> None:
    """It acts on the output of the same row, as a direct path and an output that is recorded late do, which remain."""
    random, along = np.random.default_rng(seed), "where a controller opposes it"
    u = np.asarray(lfilter([1.0], [1.0, -0.8], random.standard_normal(1502)))
    lag, direct = rp.TransferFunction([2.0], [1.0, 2.0]), rp.TransferFunction([0.4, 2.8], [1.0, 2.0])
    y, late = lag.simulate(u, 0.1, input_hold="foh"), lag.simulate(u, 0.1)[1:]
    for output, named in ((y, "run straight between"), (direct.simulate(u, 0.1), along), (late, along)):
        noisy = output[:1500] + 0.05 * output.std() * random.standard_normal(1500)
        verdict = rp.fit(u[:1500], noisy, 0.1, poles=1).verdict
        assert verdict.status == "inconsistent", verdict.reasons
        assert named in verdict.reasons[0], verdict.reasons
        other = along if named != along else "run straight between"
        assert not any(other in reason for reason in verdict.reasons), verdict.reasons


def test_a_zero_that_makes_up_for_the_hold_is_not_taken_for_it() -> None:
    """A resonance of little damping: held, its zero comes out with the wrong sign, and explains the output as well."""
    plant, dt = rp.TransferFunction([-0.002, 4.0], [1.0, 12.0, 35100.0]), 0.0016
    u = multisine(SAMPLES, dt, np.geomspace(0.2, 3.0, 12) * 187.0 / (2.0 * np.pi), amplitude=0.4)
    y = plant.simulate(u, dt, input_hold="foh")
    y += 0.03 * y.std() * np.random.default_rng(1).standard_normal(y.size)
    found = rp.fit(u, y, dt, rp.Structure(2, 1))
    assert found.parameters[2] > 0.0
    assert any("do not tell a held input" in reason for reason in found.verdict.reasons), found.verdict.reasons


def with_lost_rows(
    input_hold: str, seed: int, begins: list[int], most: int, *, drift: float = 0.0, noise: float = 0.0
) -> tuple[np.ndarray, ...]:
    """A smooth record of which up to ``most`` rows in a row were lost."""
    random = np.random.default_rng([seed, 3])
    t = 0.1 * np.arange(1500)
    u, kept = np.sin(0.9 * t) + np.sin(0.4 * t + 1.0), np.ones(t.size, bool)
    for begin in begins:
        kept[begin : begin + int(random.integers(1, most + 1))] = False
    y = PLANT.simulate(u, 0.1, input_hold=input_hold)
    white = random.standard_normal(t.size)
    y += y.std() * (noise * white + drift * np.cumsum(white) / np.cumsum(white).std())
    return u[kept], y[kept], t[kept]


@pytest.mark.slow
@every("seed", range(4), quick=1)
def test_lost_rows_do_not_make_a_held_input_straight(seed: int) -> None:
    """Through them a straight line is nearer to what the input did than one step, whatever its hold is."""
    lost = np.random.default_rng(seed).choice(np.arange(20, 1480), 25, replace=False).tolist()
    said = []
    for hold in ("zoh", "foh"):
        u, y, t = with_lost_rows(hold, seed, lost, most=3, drift=0.003)
        said.append("seems to run straight" in " ".join(rp.fit(u, y, 0.1, STRUCTURE, t=t).verdict.reasons))
    assert said == [False, True]


def test_gaps_do_not_make_a_held_input_straight() -> None:
    u, y, t = with_lost_rows("zoh", 1, [100, 400, 900], most=15, noise=0.2)
    ident = rp.Identifier(STRUCTURE, 0.1)
    ident.update_many(u, y, t)
    reasons = ident.assess().reasons
    assert not any("seems to run straight" in reason for reason in reasons), reasons


LATE = "the input seems to act"


def late(plant: rp.TransferFunction, delay: float, given: float, seed: int) -> rp.Assessment:
    """The verdict on a plant with a dead time, in s, where another one is given; noise of 3 %."""
    u = random_steps(SAMPLES, shortest=5, longest=40, low=-1.0, high=1.0, seed=seed)
    y = rp.TransferFunction(plant.num, plant.den, delay).simulate(u, 0.1)
    y += 0.03 * y.std() * np.random.default_rng(seed).standard_normal(y.size)
    structure = rp.Structure(plant.den.size - 1, plant.num.size - 1, given)
    return rp.fit(u, y, 0.1, structure).verdict


@pytest.mark.slow
@every(("delay", "given"), [(0.05, 0.0), (0.15, 0.1), (0.2, 0.1), (0.25, 0.3)])
@every("seed", range(3), quick=1)
def test_half_a_sample_of_dead_time_is_said(delay: float, given: float, seed: int) -> None:
    """And how long it is: to first order, within a tenth of a sample."""
    found = late(rp.TransferFunction([2.0], [1.0, 1.5, 1.0]), delay, given, seed)
    (reason,) = [reason for reason in found.reasons if LATE in reason]
    assert float(reason.split("with a dead time of ")[1].split()[0]) == pytest.approx(delay, abs=0.01)
    assert ("later" in reason) == (delay > given)


@every("seed", range(6), quick=1)
def test_the_right_dead_time_is_no_other(seed: int) -> None:
    for delay in (0.0, 0.05, 0.3):
        found = late(PLANT, delay, delay, seed)
        assert found.status == "trusted", found.reasons
        assert LATE not in " ".join(found.reasons)


@every("seed", range(3), quick=1)
def test_a_slow_pole_too_few_is_no_dead_time(seed: int) -> None:
    u = random_steps(SAMPLES, shortest=5, longest=40, low=-1.0, high=1.0, seed=seed)
    y = PLANT.simulate(u, 0.1)
    y += 0.03 * y.std() * np.random.default_rng(seed).standard_normal(y.size)
    found = rp.fit(u, y, 0.1, rp.Structure(1)).verdict
    assert found.status == "inconsistent"
    assert LATE not in " ".join(found.reasons)


@every("seed", range(3), quick=1)
def test_a_smooth_input_is_found_out_though_a_zero_has_made_up_for_it(seed: int) -> None:
    """The zero has moved by many times itself, so that what a straight input changes is not of first order."""
    plant, dt = rp.TransferFunction([2.8, -2310.0], [1.0, 39.2, 505.0]), 0.0137
    u = multisine(SAMPLES, dt, np.geomspace(4.5, 67.0, 12) / (2.0 * np.pi), amplitude=0.4)
    y = plant.simulate(u, dt, input_hold="foh")
    y += 10.0 ** (-30.0 / 20.0) * y.std() * np.random.default_rng(seed).standard_normal(y.size)
    for hold in ("foh", "zoh"):
        found = rp.fit(u, y, dt, poles=2, zeros=1, filter=rp.RefinedFilter(input_hold=hold)).verdict
        assert any("run straight between its samples" in reason for reason in found.reasons) == (hold == "zoh")


LAG, LAG_DT = rp.TransferFunction([2.0], [0.3, 1.0]), 0.05  # a0 is 3.33


def at_once(seed: int, *, early: int = 0, part: float = 0.0) -> rp.Assessment:
    """The verdict on a first-order lag whose outputs come some rows early, or with a part of the input at once."""
    u = random_steps(3000, shortest=20, longest=80, low=-1.0, high=1.0, seed=seed)
    y = LAG.simulate(u, LAG_DT) + part * u
    y = np.append(y[early:], np.full(early, y[-1])) + 0.02 * np.random.default_rng(seed).standard_normal(u.size)
    return rp.fit(u, y, LAG_DT, poles=1).verdict


@every("seed", range(8), quick=3)
def test_an_output_from_after_its_input_has_acted_is_not_trusted(seed: int) -> None:
    """A coefficient is 20 % off, 24 standard deviations; what the input could still explain is .01 % of the power."""
    found = at_once(seed, early=1)
    assert found.status == "inconsistent", found.reasons
    assert "of the same sample, along with it" in found.reasons[0]
    assert not any("the loop is closed" in reason for reason in found.reasons)
    (reason,) = [reason for reason in found.reasons if "s before its row" in reason]
    assert float(reason.split("a coefficient differs by ")[1].split()[0]) == pytest.approx(20.0, abs=3.0)


@every("seed", range(6), quick=2)
def test_a_direct_path_matters_by_what_it_makes_of_the_coefficients(seed: int) -> None:
    """Of .5 a coefficient is 40 % off, of .02 3.5 %."""
    assert at_once(seed, part=0.5).status == "inconsistent"
    assert at_once(seed, part=0.02).status == "trusted"
    assert at_once(seed).status == "trusted"


def late_loop(seed: int, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """1/(s + .5) behind a dead time of some rows of .1 s, under a PI controller: input, output and reference."""
    r, noise = steps(seed, 3000, 60), 0.02 * np.random.default_rng(seed).standard_normal(3000)
    decay, x, integral = np.exp(-0.05), 0.0, 0.0
    u, y = np.zeros(r.size + rows), np.empty(r.size)  # of u the newest row is the last, so that the plant sees u[k]
    for k in range(r.size):
        y[k] = x + noise[k]
        integral += 0.1 * (r[k] - y[k])
        u[k + rows] = 2.0 * (r[k] - y[k]) + integral
        x = decay * x + (1.0 - decay) * 2.0 * u[k]
    return u[rows:], y, r


@pytest.mark.slow
@every("with_reference", [True, False])
@every("seed", range(6), quick=2)
def test_a_dead_time_is_missed_in_a_loop_as_in_open_loop(seed: int, with_reference: bool) -> None:
    """With its reference or without: coefficients are 6 to 8 % low, ten standard deviations."""
    u, y, r = late_loop(seed, rows=1)
    for delay, status in ((0.0, "inconsistent"), (0.1, "trusted")):
        found = rp.fit(u, y, 0.1, poles=1, delay=delay, reference=r if with_reference else None).verdict
        assert found.status == status, found.reasons
        said = [reason for reason in found.reasons if LATE in reason]
        assert len(said) == (delay == 0.0), found.reasons
        for reason in said:
            assert float(reason.split("with a dead time of ")[1].split()[0]) == pytest.approx(0.1, abs=0.02)
