"""A branch of a row, from its input alone, and the whole chain of filters beside an output of nought: the same bits."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from support.cases import every

SIZE, DT = 120, 0.1


@every("seed", range(40), quick=8)
def test_a_branch_has_the_bits_of_the_chain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poles = int(rng.integers(1, 5))
    structure = rp.Structure(poles, zeros=int(rng.integers(0, poles)), delay=float(rng.choice([0.0, 0.05, 0.37, 1.2])))
    hold, intervals = str(rng.choice(["zoh", "foh"])), DT * rng.choice([1.0, 1.01, 0.5, 3.0], SIZE)
    record = Record(rng.normal(size=SIZE), np.zeros(SIZE), np.array([DT]) if seed % 2 else intervals, hold)
    denominator = np.poly(-rng.uniform(0.1, 5.0, poles)) if seed % 5 else np.poly(rng.uniform(-5.0, 2.0, poles))
    theta = [denominator[1:], rng.normal(size=structure.zeros + 1), np.zeros(1), rng.normal(size=poles)]
    whole, alone = AuxiliaryModel(structure, DT, hold), AuxiliaryModel(structure, DT, hold)
    constant, model = bool(rng.integers(2)), np.concatenate(theta)
    is_told = (np.arange(whole.entries) != structure.size) | constant
    pairs = [(whole.run(model, record), alone.branch(model, record, constant=constant))]
    pairs.append((whole.go_on(model, record), alone.branch(None, record, constant=constant)))
    for done, (rows, output) in pairs:
        np.testing.assert_array_equal(output, done.output)
        np.testing.assert_array_equal(rows[:, is_told], done.zeta[:, is_told])
