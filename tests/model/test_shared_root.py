"""A pole that a zero may cancel: found where there is one too many, in any units, and nowhere else."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.model.uncertainty import Uncertainty, cancelled_pole
from replant.signals import prbs
from support.cases import every

DT = 0.1
LAG = rp.TransferFunction([2.0], [1.0, 0.5])
SWINGS = rp.TransferFunction([2.0], [1.0, 0.6, 4.0])


def fitted(plant: rp.TransferFunction, poles: int, zeros: int, seed: int, samples: int = 3000) -> Any:
    u = prbs(samples, hold=8, seed=seed + 1)
    y = plant.simulate(u, DT)
    y += 0.2 * y.std() * np.random.default_rng(seed).standard_normal(samples)
    return rp.fit(u, y, DT, poles=poles, zeros=zeros)


@every(("plant", "poles", "zeros"), [(LAG, 2, 1), (SWINGS, 3, 1), (SWINGS, 4, 2), (LAG, 3, 2)], quick=2)
@every("seed", range(4), quick=1)
def test_a_pair_too_many_leaves_the_coefficients_unknown(
    plant: rp.TransferFunction, poles: int, zeros: int, seed: int
) -> None:
    found = fitted(plant, poles, zeros, seed)
    pole = found.uncertainty.cancelled_pole
    assert pole is not None
    assert pole.imag >= 0.0
    assert np.abs(found.transfer_function.poles - pole).min() < 1e-9 * abs(pole)
    assert np.isinf(found.uncertainty.std).all()
    unknown = [mode for mode in found.uncertainty.modes if math.isinf(mode.time_constant_std)]
    assert len(unknown) == 1
    assert any("may cancel the pole" in reason for reason in found.verdict.reasons)
    assert math.isinf(found.verdict.uncertainty)
    if math.isfinite(found.verdict.condition):  # else a zero lies at infinity, and float64 has no digits of it left
        assert (found.uncertainty.response([0.3, 1.0, 3.0])[0] < 0.1).all(), "what the input excites is known"


@pytest.mark.slow
@every("seed", range(4))
def test_a_right_structure_is_told(seed: int) -> None:
    for plant, poles, zeros in (
        (LAG, 1, 0),
        (SWINGS, 2, 0),
        (rp.TransferFunction([1.0, 3.0], [1.0, 0.6, 4.0]), 2, 1),
        (rp.TransferFunction([1.0, 0.3, 1.0], [1.0, 1.1, 4.3, 2.0]), 3, 2),
    ):
        found = fitted(plant, poles, zeros, seed)
        assert found.uncertainty.cancelled_pole is None
        np.testing.assert_array_equal(found.uncertainty.std, np.sqrt(np.diag(found.covariance)))


def test_two_poles_and_two_zeros_are_found_together() -> None:
    """A resonance that its zeros cancel: neither pole alone can go, as the coefficients are real."""
    pair = np.array([1.0, 0.2, 9.0])
    structure, parameters = rp.Structure(3, 2), np.concatenate([np.polymul([1.0, 0.5], pair)[1:], 2.0 * pair])
    covariance = np.diag((0.02 * np.abs(parameters)) ** 2)
    pole = cancelled_pole(structure, parameters, covariance)
    assert pole == pytest.approx(complex(-0.1, math.sqrt(9.0 - 0.01)))


@every("faster", [1e-6, 1.0, 1e5])
@every("larger", [1e-8, 1e9])
@every("zero", [0.93, 20.0])
def test_units_make_no_difference(faster: float, larger: float, zero: float) -> None:
    structure, parameters = rp.Structure(2, 1), np.array([3.0, 2.0, 1.0, zero])
    covariance = np.diag([0.1, 0.1, 0.05, 0.03]) ** 2
    plain = cancelled_pole(structure, parameters, covariance)
    scale = np.array([faster, faster**2, larger * faster, larger * faster**2])
    scaled = cancelled_pole(structure, parameters * scale, covariance * np.outer(scale, scale))
    assert (plain is None) == (scaled is None) == (zero == 20.0)
    if plain is not None:
        assert scaled == pytest.approx(plain * faster)


@pytest.mark.filterwarnings("error")
@every("value", [math.nan, math.inf, 0.0, 1e-300, 1e300])
@every("structure", [rp.Structure(2, 1), rp.Structure(10, 9), rp.Structure(1, 1, feedthrough=True)])
def test_no_covariance_is_too_odd(structure: rp.Structure, value: float) -> None:
    for parameters in (np.zeros(structure.size), np.ones(structure.size), np.full(structure.size, 1e300)):
        found = Uncertainty(structure, parameters, np.full((structure.size, structure.size), value))
        assert found.cancelled_pole is None or isinstance(found.cancelled_pole, complex)
        assert found.std.shape == (structure.size,)
    assert cancelled_pole(structure, np.full(structure.size, math.nan), np.eye(structure.size)) is None


def test_unknown_coefficients_are_null_in_a_file(tmp_path: Path) -> None:
    model = fitted(LAG, 2, 1, 0).model
    model.save(tmp_path / "model.json")
    entries = json.loads((tmp_path / "model.json").read_text())["parameters"]
    assert all(entry["std"] is None for entry in entries.values())
    assert rp.load_model(tmp_path / "model.json") == model


def test_what_is_decided_by_a_pole_s_place_does_not_lose_it() -> None:
    """Whether a pole is unstable, or an integrator's, follows from the covariance, also where a zero may cancel it."""
    structure, covariance = rp.Structure(2, 1), np.diag([0.01, 0.01, 0.01, 0.01]) ** 2
    known = Uncertainty(structure, np.array([1.0, -2.0, 1.0, -1.0]), covariance)
    assert known.cancelled_pole == pytest.approx(1.0)
    (unstable,) = (mode for mode in known.first_order_modes if mode.mode.pole.real > 0.0)
    assert unstable.covariance[0, 0] < 0.01**2
    for mode in known.modes:
        assert math.isinf(mode.covariance[0, 0]) == (mode.mode.pole == unstable.mode.pole)


def test_people_read_unknown() -> None:
    found = fitted(LAG, 2, 1, 0)
    assert found.model._repr_html_().count("± unknown") == 4
