"""A sensor with steps: ten bits of a converter, four digits of a line.  What it repeats by right is no failure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import replant as rp
from replant.live.streams.demo import demo_voltage
from replant.rigs import deap_rig
from support.builders import true_parameters
from support.cases import every

RIG = deap_rig()
PLANTS = {  # plant, sampling time, how long the input is held at the least and at the most
    "slow": (rp.TransferFunction([2.0], [1.0, 2.0]), 1e-3, (200, 600)),
    "settles": (rp.TransferFunction([60.0], [1.0, 16.0, 60.0]), 0.01, (5, 200)),
}
Scale = Callable[[np.ndarray], np.ndarray]


def bits(count: int) -> Scale:
    """A converter whose scale is a fifth wider than the signal."""
    return lambda y: np.round(y / (1.2 * np.ptp(y)) * 2**count) * (1.2 * np.ptp(y)) / 2**count


def digits(count: int) -> Scale:
    return lambda y: np.array([float(f"{value:.{count}g}") for value in y])


SCALES = {"8 bits": bits(8), "10 bits": bits(10), "12 bits": bits(12), "4 digits": digits(4), "6 digits": digits(6)}


def measured(name: str, samples: int, noise: float) -> tuple[rp.Identifier, np.ndarray, np.ndarray, np.ndarray]:
    """Return who identifies it, the record, and what is true."""
    if name == "demo":
        u = demo_voltage(samples, 3)
        preprocess = rp.Preprocess("square", "mean", "mean")
        ident = rp.Identifier(rp.Structure(3, 1), RIG.dt, preprocess=preprocess)
        return ident, u, RIG.measure(u, 4), true_parameters(RIG.plant, 1)
    plant, dt, (shortest, longest) = PLANTS[name]
    rng, steps = np.random.default_rng(3), []
    while len(steps) < samples:
        steps += [rng.choice([-1.0, -0.5, 0.5, 1.0])] * int(rng.integers(shortest, longest))
    u = np.array(steps[:samples])
    y = 5.0 + plant.simulate(u, dt) + noise * np.random.default_rng(4).standard_normal(samples)
    return rp.Identifier(rp.Structure(plant.den.size - 1), dt), u, y, true_parameters(plant, 0)


NOISES = [("slow", 0.0), ("slow", 0.003), ("settles", 0.0), ("settles", 0.003), ("demo", 1e-3)]
#: Each scale with two of them, and each of them with two scales.
ROUNDED = [(*NOISES[(k + shift) % 5], scale) for shift in (0, 2) for k, scale in enumerate(SCALES)]


@every(("name", "noise", "scale"), ROUNDED, quick=1)
def test_what_is_rounded_is_not_stuck(name: str, noise: float, scale: str) -> None:
    """A number that comes twice by chance, and an output that has settled between two steps: none is bridged."""
    ident, u, y, true = measured(name, 20_000, noise)
    ident.update_many(u, SCALES[scale](y))
    assert ident.rejected["stuck"] == 0
    assert ident.assess().status == "trusted"
    assert np.abs(ident.parameters / true - 1.0).max() < 0.05


@every("scale", SCALES, quick=1)
def test_a_start_up_tells_the_sensor_s_step(scale: str) -> None:
    """It is the smallest difference between neighbours that are not equal, however small the output's unit is."""
    ident, u, y, _ = measured("slow", 500, 0.003)
    y = SCALES[scale](1e-3 * y)
    ident.update_many(u, y)
    steps = np.abs(np.diff(y))
    assert ident._state.sensor_step == pytest.approx(steps[steps > 0.0].min(), rel=1e-6)


def test_outliers_do_not_make_a_scale_finer() -> None:
    """What is bridged lies between the steps; the record is solved again with it, and the scale stays what it is."""
    ident, u, y, _ = measured("slow", 20_000, 0.003)
    y = SCALES["8 bits"](y)
    for begin in (900, 1900, 3900):  # shortly before it is solved again
        y[begin : begin + 90 : 6] += 100.0
    ident.update_many(u, y)
    assert ident.rejected["outlier"] > 30
    assert ident.rejected["stuck"] == 0


@every("scale", SCALES, quick=2)
@pytest.mark.parametrize("fault", ["stuck", "off", pytest.param("at its rail", marks=pytest.mark.slow), "saturated"])
@pytest.mark.parametrize("name", ["slow", pytest.param("settles", marks=pytest.mark.slow)])
def test_a_sensor_with_steps_that_fails_is_told_and_not_learned(name: str, fault: str, scale: str) -> None:
    """Not trusted two seconds after the first number that is clearly wrong, and the parameters hold within 1 %."""
    good, lasts = 10_000, 3000
    ident, u, healthy, _ = measured(name, good + lasts, 0.003)
    y = healthy.copy()
    limit = y.mean() + 0.8 * y.std()
    y[good:] = {"stuck": y[good], "off": 0.0, "at its rail": y.max(), "saturated": np.minimum(y, limit)[good:]}[fault]
    wrong, y = good + int(np.argmax(np.abs(y - healthy)[good:] > 0.1 * y.std())), SCALES[scale](y)
    ident.update_many(u[:good], y[:good])
    assert ident.assess().status == "trusted"
    before, soon = ident.parameters, min(wrong + round(2.0 / ident.dt), good + lasts)
    parts = [ident.update_many(u[good:soon], y[good:soon])]
    assert ident.assess().status != "trusted"
    parts.append(ident.update_many(u[soon:], y[soon:]))
    for trace in parts:
        assert np.abs(trace.parameters / before - 1.0).max(initial=0.0) < 0.01


@pytest.mark.slow
def test_a_resonance_whose_crests_are_cut_is_told_and_not_learned() -> None:
    """The demo's rig after a minute: its parameters are known to a third of a percent, and hold within one."""
    for seed, level in ((1, 0.5), (2, 1.2)):
        u = demo_voltage(64_000, seed)
        y = RIG.measure(u, seed + 1)
        ident = rp.Identifier(rp.Structure(3, 1), RIG.dt, preprocess=rp.Preprocess("square", "mean", "mean"))
        ident.update_many(u[:60_000], y[:60_000])
        assert ident.assess().status == "trusted"
        before = ident.parameters
        cut = np.clip(y, y.mean() - level * y.std(), y.mean() + level * y.std())[60_000:]
        since = 60_000 + int(np.argmax(cut != y[60_000:]))
        parts = []
        for begin in range(60_000, 64_000, 200):
            now = slice(begin, begin + 200)
            parts.append(ident.update_many(u[now], cut[begin - 60_000 : begin - 59_800]).parameters)
            recent = y[max(begin - 800, 60_000) : begin + 200] != cut[max(begin - 60_800, 0) : begin - 59_800]
            assert not (begin + 200 > since + 2000 and recent.any() and ident.assess().status == "trusted")
        assert np.abs(np.vstack(parts) / before - 1.0).max() < 0.01
