"""Every optimizer, from the register: its kernel equals its naive twin, it finds the plant, it refuses bad settings."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.optimizers import OPTIMIZERS
from support.builders import G1, identifier, random_plant, record, true_parameters, with_and_without
from support.cases import every
from support.references import TWINS, identify, regressor

every_optimizer = every("name", OPTIMIZERS)
DT, SAMPLES = 0.2, 120
REPLAY = rp.Replay(capacity=45, batch_size=4, warmup=6, seed=7)  # wraps twice within the record


def made(name: str) -> Any:
    return OPTIMIZERS[name](**TWINS[name].settings)


def test_every_optimizer_has_a_twin() -> None:
    assert set(TWINS) == set(OPTIMIZERS), "write the twin of a new optimizer in tests/references.py"


def test_codes_are_unique() -> None:
    assert len({optimizer.code for optimizer in OPTIMIZERS.values()}) == len(OPTIMIZERS)


def worst_error(name: str, seed: int, **changes: Any) -> tuple[float, float]:
    """Compare kernel and twin on one random system: the largest errors of parameters and of output errors.

    Both relative to the largest value that the quantity takes over the record.
    """
    order = changes.pop("order")
    generator = np.random.default_rng([seed, order])
    zeros = int(generator.integers(0, order))
    structure = rp.Structure(order, zeros, delay=changes.pop("delay", 0.0), bias=changes.pop("bias", False))
    state_filter = changes.pop("state_filter", rp.StateVariableFilter(cutoff=generator.uniform(1.0, 3.0)))
    u, y = record(random_plant(seed, order, zeros), seed, SAMPLES, DT, noise=0.1)
    settings = {"dt": DT, "replay": None, "normalize": True, **changes}
    phi = regressor(u, y, structure=structure, state_filter=state_filter, dt=DT)
    sigmas = np.sqrt(np.mean(phi**2, axis=0)) * generator.uniform(0.5, 2.0, structure.size)
    scaling = rp.Scaling(float(y.std()), tuple(sigmas.astype(float)))
    optimizer = made(name)
    update = TWINS[name].rule(optimizer, structure.size, DT, settings["normalize"])
    parameters, errors = identify(
        u, y, structure=structure, state_filter=state_filter, scaling=scaling, update=update, **settings
    )
    ident = rp.Identifier(
        structure, filter=state_filter, scaling=scaling, optimizer=optimizer, instruments=False, **settings
    )
    trace = ident.update_many(u, y)
    assert np.isfinite(trace.parameters).all()
    assert np.abs(parameters).max() > 0
    size = np.abs(parameters).max(axis=0)
    return (
        float((np.abs(trace.parameters - parameters).max(axis=0) / size).max()),
        float(np.abs(trace.errors - errors).max() / np.abs(errors).max()),
    )


@with_and_without(REPLAY)
@every("order", range(1, 7), quick=3)
def test_kernel_equals_its_twin(name: str, order: int, replay: rp.Replay | None) -> None:
    parameters, errors = worst_error(name, seed=order, order=order, replay=replay)
    assert parameters < 1e-12
    assert errors < 1e-12


VARIANTS: dict[str, dict[str, Any]] = {
    "bias": {"bias": True},
    "no normalisation": {"normalize": False},
    "dead time of whole samples": {"delay": 3 * DT},
    "dead time of 1.37 samples": {"delay": 1.37 * DT},
    "first-order hold": {"state_filter": rp.StateVariableFilter(2.0, input_hold="foh")},
    "first-order hold, 0.61 samples late": {
        "state_filter": rp.StateVariableFilter(2.0, input_hold="foh"),
        "delay": 0.61 * DT,
    },
    "any denominator": {"state_filter": rp.StateVariableFilter(denominator=[1.0, 3.0, 7.0, 4.0])},
    "Tustin": {"state_filter": rp.StateVariableFilter(2.0, method="gbt")},
    "Tustin, 2.25 samples late": {"state_filter": rp.StateVariableFilter(2.0, method="gbt"), "delay": 2.25 * DT},
    "forward Euler": {"state_filter": rp.StateVariableFilter(2.0, method="gbt", alpha=0.0)},
    "backward Euler": {"state_filter": rp.StateVariableFilter(2.0, method="gbt", alpha=1.0)},
    "one row of memory": {"replay": rp.Replay(capacity=1, batch_size=3, warmup=0)},
    "batch above capacity": {"replay": rp.Replay(capacity=5, batch_size=8, warmup=2, seed=2**62 + 3)},
    "batches that wait for a full buffer": {"replay": rp.Replay(capacity=5, batch_size=8, warmup=50)},
    "batches that never begin": {"replay": rp.Replay(capacity=500, batch_size=8, warmup=400)},
}


@every("variant", VARIANTS)
def test_every_setting_of_the_schema_equals_the_twin(variant: str) -> None:
    parameters, errors = worst_error("amsgrad", seed=11, order=3, **{"replay": REPLAY, **VARIANTS[variant]})
    assert parameters < 1e-12
    assert errors < 1e-12


@every_optimizer
def test_the_unit_of_the_output_does_not_matter(name: str) -> None:
    """With y and its sigmas in another unit, a stays as it is and b follows; to the bit, the factor being 2^7."""
    u, y = record(G1, seed=3, samples=300, dt=0.05, noise=0.1)
    factor = 2.0**7
    plain, scaled = (
        identifier(made(name), structure=rp.Structure(1), scaling=rp.Scaling(0.5 * c, [0.1 * c, 0.2]))
        for c in (1.0, factor)
    )
    before, after = plain.update_many(u, y), scaled.update_many(u, factor * y)
    np.testing.assert_array_equal(after.parameters[:, 0], before.parameters[:, 0])
    np.testing.assert_array_equal(after.parameters[:, 1], factor * before.parameters[:, 1])
    np.testing.assert_array_equal(after.errors, factor * before.errors)


@with_and_without(rp.Replay())
def test_the_suggested_settings_find_the_plant(name: str, replay: rp.Replay | None) -> None:
    """A noise-free record of forty time constants: G1 within 1 %, from a start at zero."""
    u, y = record(G1, seed=5, samples=8000, dt=0.01, hold=50)
    ident = rp.Identifier(rp.Structure(1), 0.01, filter=rp.StateVariableFilter(5.0), optimizer=name, replay=replay)
    ident.update_many(u, y)
    assert isinstance(ident.settings.optimizer, OPTIMIZERS[name])
    np.testing.assert_allclose(ident.parameters, true_parameters(G1, 0), rtol=0.01)


@every_optimizer
def test_settings_are_stored_as_given_and_frozen(name: str) -> None:
    optimizer = made(name)
    for field, value in TWINS[name].settings.items():
        assert getattr(optimizer, field) is value
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(optimizer, field, value)


#: What is bad for most settings and means something for these.
MEANT = {("time_constant", "None"), ("process_noise", "[0.1]")}


@every_optimizer
@every("bad", [-1.0, float("nan"), float("inf"), "a", None, 1j, [0.1]], ids=repr)
def test_bad_settings_are_refused_by_name(name: str, bad: Any) -> None:
    for field in dataclasses.fields(OPTIMIZERS[name]):
        if (field.name, repr(bad)) in MEANT:
            continue
        with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=field.name) as caught:
            OPTIMIZERS[name](**{**TWINS[name].settings, field.name: bad})
        assert "\n" not in str(caught.value)


@every("optimizer", [rp.Adam, rp.AMSGrad, rp.NAdam])
@every("field", ["beta1", "beta2"])
def test_moments_that_never_move_are_refused(optimizer: Any, field: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=field):
        optimizer(step_size=0.1, **{field: 1.0})


@pytest.mark.parametrize("name", [name for name, kind in OPTIMIZERS.items() if kind.keeps_covariance])
def test_an_optimizer_that_remembers_every_sample_refuses_a_buffer(name: str) -> None:
    with pytest.raises(
        rp.InvalidArgumentError, match=f"^{type(made(name)).__name__} uses every sample already: replay must be None"
    ):
        rp.Identifier(rp.Structure(1), 0.1, optimizer=made(name), replay=rp.Replay())
    assert rp.Identifier(rp.Structure(1), 0.1, optimizer=made(name), replay=None).status == "starting"


def test_a_factor_and_a_time_constant_do_not_go_together() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="forgetting_factor or a time_constant, not both"):
        rp.RecursiveLeastSquares(forgetting_factor=0.99, time_constant=10.0)


def test_gradient_is_stable_below_two_whatever_the_signals() -> None:
    """The normalised step shrinks the error of a sample by 1 - Tp gamma phi' phi / m^2: for Tp gamma < 2 never grows.

    So does the distance to the true parameters, where the equations hold exactly: y = phi' theta, here b0 = 3 with
    a0 = 0, the plant being an integrator whose filtered output is exact for a held input.
    """
    plant, dt = rp.TransferFunction([3.0], [1.0, 0.0]), 0.1
    u, y = record(plant, seed=1, samples=500, dt=dt, hold=1)
    ident = identifier(rp.Gradient(gain=1.99 / dt), structure=rp.Structure(1), dt=dt, replay=None)
    trace = ident.update_many(100 * u, 100 * y)
    distance = np.linalg.norm(np.vstack([trace.start, trace.parameters]) - [0.0, 3.0], axis=1)
    assert (np.diff(distance) <= 1e-12).all()
    assert distance[-1] < 0.1 * distance[0]


@pytest.mark.parametrize("name", ["adam", "nadam"])
def test_powers_of_beta_never_leave_the_normal_numbers(name: str) -> None:
    """Products of smaller ones take some processors a hundred times as long, for as long as the stream runs."""
    ident = identifier(OPTIMIZERS[name](1e-3, beta1=0.5, beta2=0.5))
    ident.update_many(*np.random.default_rng(3).standard_normal((2, 2000)))
    powers = ident._state.memory[-2:]
    assert 0.5**2000 < np.finfo(float).tiny <= powers.min()
    assert (1.0 - powers == 1.0).all()
