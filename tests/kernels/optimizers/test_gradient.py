"""Every optimizer's kernel with instruments, row by row against its twin: the update follows zeta where it had phi."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.estimation.engine.dimensions import Dimensions
from replant.estimation.engine.state import State
from replant.estimation.optimizers import OPTIMIZERS
from replant.kernels import schema as at
from replant.kernels.optimizers import covariance, gradient
from replant.kernels.step.stages import cut_estimate, direction_of
from support.cases import every
from support.references import TWINS, extended

DT, ROWS = 0.2, 60


@every("name", OPTIMIZERS)
@every("normalize", [True, False])
@every("instruments", [False, True])
def test_kernel_equals_its_twin(name: str, normalize: bool, instruments: bool) -> None:
    """Zeta is phi without its noise, as an auxiliary model makes it; without instruments it must not be looked at."""
    optimizer = OPTIMIZERS[name](**TWINS[name].settings)
    memory, numbers = optimizer.memory(4), optimizer.settings(DT, np.ones(4))
    state = State.empty(Dimensions(2, 4, 8, memory.size, numbers.size, instruments=instruments))
    state.describe(rp.Structure(2, 1), DT, rp.StateVariableFilter(2.0), np.ones(4), 1.0)
    state.memory[:], state.settings[:], state.algorithm = memory, numbers, optimizer.code
    P = state.entries
    generator = np.random.default_rng(P)
    zeta = generator.standard_normal((ROWS, P))
    phi = zeta + 0.3 * generator.standard_normal((ROWS, P))
    target = phi @ np.arange(1.0, P + 1) + 0.1 * generator.standard_normal(ROWS)
    update = TWINS[name].rule(optimizer, P, DT, normalize)
    expected = extended(np.zeros(P))
    s, loops = state.fields, covariance if optimizer.keeps_covariance else gradient
    for k in range(ROWS):
        along = zeta[k] if instruments else phi[k]
        row = np.concatenate([phi[k], [target[k], 1 / (1 + along @ along) if normalize else 1.0], zeta[k]])
        state.ints[at.ROWS] = 0
        state.buffer = row[None, :]
        theta, memory, *_, settings, rows = cut_estimate(s)
        loops.learn(s.algorithm, theta, memory, settings, state.buffer, rows, 1, direction_of(s), DT)
        arguments = (extended(phi[k]), extended(target[k]), *([extended(zeta[k])] if instruments else []))
        expected = update(expected, *arguments)
        np.testing.assert_allclose(state.theta, expected.astype(float), atol=1e-12 * float(np.abs(expected).max()))
    assert np.abs(expected).max() > 1e-3


@every("name", OPTIMIZERS)
def test_codes_name_the_kernels(name: str) -> None:
    """The number that a kernel branches on is spelled there as the optimizer is here."""
    loops = covariance if OPTIMIZERS[name].keeps_covariance else gradient
    assert getattr(loops, name.replace("-", "_").upper()) == OPTIMIZERS[name].code


def test_every_loop_declares_the_memory_of_one_optimizer() -> None:
    codes = {optimizer.code for optimizer in OPTIMIZERS.values()}
    assert {*gradient.MEMORY, *covariance.MEMORY} == codes
    assert len(gradient.MEMORY) + len(covariance.MEMORY) == len(codes)


def test_a_memory_with_a_covariance_begins_with_its_factors_and_ends_with_alpha() -> None:
    """Outlier test, covariance and checkpoint find them there, whatever the optimizer is."""
    for memory in covariance.MEMORY.values():
        names = list(memory.sizes)
        assert names[:2] == ["U", "D"]
        assert names[-1] == "alpha"
        assert memory.sizes["alpha"].at(3) == 1
