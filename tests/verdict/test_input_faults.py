"""An actuator that is not linear is named, whatever its curve; a linear one never is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import replant as rp
from replant.kernels.filters.autoregressions import play
from replant.signals import random_steps
from support.builders import DT, binary
from support.cases import every

PLANT, STRUCTURE = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), rp.Structure(2)
SAMPLES = 6000
ACTUATORS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "saturate": lambda u: np.clip(u, -0.4, 0.4),
    "dead zone": lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.4, 0.0),
    "other direction": lambda u: np.where(u > 0.0, 1.5 * u, 0.5 * u),
    "play or friction": lambda u: play(u, 0.4),
}


def steps(seed: int, offset: float = 0.0) -> np.ndarray:
    return offset + random_steps(SAMPLES, shortest=5, longest=40, low=-1.0, high=1.0, seed=seed)


def verdict(u: np.ndarray, moved: np.ndarray, seed: int, plant: rp.TransferFunction = PLANT) -> rp.Assessment:
    """The verdict on a plant that gets ``moved`` where ``u`` is logged, with noise of 3 %."""
    y = plant.simulate(moved, DT)
    y += 0.03 * y.std() * np.random.default_rng(seed).standard_normal(y.size)
    ident = rp.Identifier(rp.Structure(plant.den.size - 1, plant.num.size - 1), DT)
    ident.update_many(u, y)
    return ident.assess()


@pytest.mark.slow
@every("gain", [1.0, -3.0], quick=1)
@every("fault", ACTUATORS, quick=2)
def test_it_is_named(fault: str, gain: float) -> None:
    """Also behind a plant whose gain is negative: a saturation stays one."""
    u = steps(seed=1)
    found = verdict(u, gain * ACTUATORS[fault](u), seed=2)
    assert found.status == "inconsistent"
    assert any("the actuator" in reason and fault in reason for reason in found.reasons), found.reasons


@every("seed", range(6), quick=2)
def test_a_linear_one_is_not(seed: int) -> None:
    u = steps(seed, offset=0.4 * seed)
    found = verdict(u, u, seed + 100)
    assert found.status == "trusted", found.reasons
    assert not any("actuator" in reason for reason in found.reasons)


@pytest.mark.slow
def test_an_input_of_two_levels_cannot_tell() -> None:
    """Every curve through two points is a straight line: the linear model is right for such an input."""
    u = binary(3, SAMPLES, 8)
    for fault in ("saturate", "other direction"):
        found = verdict(u, ACTUATORS[fault](u), seed=4)
        assert found.status == "trusted", found.reasons


@every("seed", range(4), quick=1)
def test_noise_of_an_input_of_two_levels_is_no_saturation(seed: int) -> None:
    """The mean of what reached the plant flattens over what was recorded; four levels at a limit do so, too."""
    rng, plant = np.random.default_rng(seed), rp.TransferFunction([2.0], [1.0, 1.0])
    white, noise = rng.standard_normal(1500), 0.05 * rng.standard_normal(1500)
    for levels, scatter, limit, is_fault in (
        ([-1.0, 1.0], 0.25, 1.0, False),
        ([-1.0, -0.4, 0.4, 1.0], 0.05, 0.6, True),
    ):
        moved = np.repeat(rng.choice(levels, 150), 10)
        recorded = moved + scatter * white
        y = plant.simulate(np.clip(recorded if is_fault else moved, -limit, limit), 0.1)
        reasons = rp.fit(recorded, y + y.std() * noise, 0.1, poles=1).verdict.reasons
        assert any("the actuator seems to saturate" in reason for reason in reasons) is is_fault, reasons


def test_a_pole_too_few_is_no_actuator() -> None:
    """What a linear fault leaves of the output is not taken for a curve of the input."""
    u, third = steps(seed=5), rp.TransferFunction([10.0], np.poly([-1.0, -3.0, -6.0]))
    y = third.simulate(u, DT)
    y += 0.03 * y.std() * np.random.default_rng(6).standard_normal(y.size)
    ident = rp.Identifier(rp.Structure(1), DT)
    ident.update_many(u, y)
    found = ident.assess()
    assert found.status == "inconsistent"
    assert not any("the actuator seems" in reason for reason in found.reasons), found.reasons


def under_control(act: Callable[[float], float], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a PI controller asks for, the output of 1/(s + 1) behind its actuator, and the set-point, for 300 s."""
    rng, dt = np.random.default_rng(seed), 0.05
    r = np.repeat(rng.uniform(-1.0, 1.0, 75), 80)
    asked, y, x, integral, keeps = np.empty(r.size), np.empty(r.size), 0.0, 0.0, np.exp(-dt)
    for k in range(r.size):
        y[k] = x + 0.02 * rng.standard_normal()
        integral += dt * (r[k] - y[k])
        asked[k] = 3.0 * (r[k] - y[k]) + 2.0 * integral
        x = keeps * x + (1.0 - keeps) * act(float(asked[k]))
    return asked, y, r


@every("seed", range(3), quick=1)
def test_an_actuator_at_its_limit_is_named_in_a_loop_with_a_reference(seed: int) -> None:
    """Its pole was 40 % off, and trusted in one of three loops."""
    u, y, r = under_control(lambda asked: min(max(asked, -1.0), 1.0), seed)
    found = rp.fit(u, y, 0.05, poles=1, reference=r).verdict
    assert found.status == "inconsistent", found.reasons
    assert any(reason.startswith("the actuator seems to saturate") for reason in found.reasons), found.reasons
    u, y, r = under_control(float, seed)
    found = rp.fit(u, y, 0.05, poles=1, reference=r).verdict
    assert found.status == "trusted", found.reasons
    assert not any("actuator" in reason for reason in found.reasons), found.reasons
