"""Functions of `estimation` by example: a few numbers each, as one would try them by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from replant.estimation.engine.dimensions import room_for
from replant.estimation.engine.record import Record, gaps_of
from replant.estimation.optimizers.optimizer import rounded
from replant.estimation.settings import filter_for
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from replant.estimation.simulation.fitted_run import FittedRun, simulate, triangle_of, weights_of
from replant.estimation.simulation.model_run import Score, model_output, runs_away
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.robust import flags_of, joined, stretches_of
from support.cases import every

#: Each is called when its case runs: what one raises is the failure of that case.
VALUES: list[tuple[str, Callable[[], object], object]] = [
    ("room_for", lambda: [room_for(samples, 30_000) for samples in (0, 1023, 1024, 20_000, 10**6)],
     [1024, 1024, 2048, 30000, 30000]),
    ("unknown", lambda: [Record(np.zeros(9), np.zeros(9), np.array([0.1])).unknown(d) for d in (0.0, 0.3, 0.32, 5.0)],
     [0, 3, 4, 9]),
    ("rounded", lambda: rounded(0.000122159), 0.000122),
    ("filter_for zoh", lambda: filter_for("zoh"), "auto"),
    ("filter_for foh", lambda: repr(filter_for("foh")), "RefinedFilter(input_hold='foh')"),
    ("runs_away", lambda: runs_away(np.array([1.0, -1.0]), 20.0), True),
    ("runs_away, integrator", lambda: runs_away(np.array([1.0, 1.0, 0.0]), 20.0), False),
    ("stretches_of", lambda: stretches_of(np.array([False, True, True, False, True]), first=10).tolist(),
     [[11, 13], [14, 15]]),
    ("flags_of", lambda: flags_of(np.array([[11, 13], [14, 15]]), 12, 4).tolist(), [True, False, True, False]),
    ("joined", lambda: joined(np.array([[1, 2], [3, 4], [9, 10]]), 1).tolist(), [[1, 4], [9, 10]]),
]  # fmt: skip
ARRAYS: list[tuple[str, Callable[[], NDArray[np.generic]], object]] = [
    ("gaps_of", lambda: gaps_of(np.array([1.0, 1.0, 9.0, 1.0, 9.0, 9.0, 9.0]), 1.0), [2]),
    ("triangle_of", lambda: np.abs(triangle_of(np.ones(4), np.array([1.0, 3.0, np.nan, 5.0]))).round(4),
     [[1.7321, 5.1962], [0.0, 2.8284]]),
    ("weights_of", lambda: weights_of(triangle_of(np.ones(3), np.array([1.0, 3.0, 5.0]))).round(9), [3.0]),
]  # fmt: skip


@every("call, expected", [row[1:] for row in VALUES], ids=[row[0] for row in VALUES])
def test_values(call: Callable[[], object], expected: object) -> None:
    assert call() == expected


@every("call, expected", [row[1:] for row in ARRAYS], ids=[row[0] for row in ARRAYS])
def test_arrays(call: Callable[[], NDArray[np.generic]], expected: object) -> None:
    np.testing.assert_allclose(call(), expected, atol=1e-8)


def test_record_restored() -> None:
    record = Record(np.array([0.0, 1.0, 4.0, 4.0]), np.zeros(4), np.array([1.0, 1.0, 3.0, 1.0]))
    restored, places = record.restored
    assert (restored.u.tolist(), restored.measured.tolist(), places.tolist()) == (
        [0.0, 1.0, 2.0, 3.0, 4.0, 4.0],
        [True, True, False, False, True, True],
        [0, 1, 4, 5],
    )


def test_auxiliarymodel() -> None:
    model = AuxiliaryModel(Structure(poles=1), dt=1.0)
    record = Record(np.ones(3), np.zeros(3), np.array([1.0, 1.0, 2.0]))
    np.testing.assert_allclose(
        model.run(np.array([1.0, 1.0, 0.0, 0.0]), record).output.round(4), np.array([0.0, 0.6321, 0.9502]), atol=1e-8
    )


def test_fittedrun() -> None:
    g = TransferFunction([2.0], [1.0, 1.0])
    u = np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    run = FittedRun(g, dt=0.1)
    output, known = run.take(u, g.simulate(u, 0.1) + 5.0)
    assert (round(run.offset, 6), bool(np.abs(output - known).max() < 1e-9)) == (5.0, True)


def test_model_output() -> None:
    g = TransferFunction([1.0], [1.0, -1.0])
    u = np.sin(np.arange(40.0))
    found = model_output(g, u, g.simulate(u, 0.1), 0.1)
    assert (found.is_prediction, found.fit > 99.0) == (True, True)


def test_simulate() -> None:
    g, u = TransferFunction([2.0], [1.0, 1.0]), np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    assert abs(simulate(g, u, g.simulate(u, 0.1) + 5.0, 0.1).offset - 5.0) < 1e-9


def test_score() -> None:
    g, u = TransferFunction([2.0], [1.0, 1.0]), np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    score = Score(g, dt=0.1)
    output = score.take(u, g.simulate(u, 0.1) + 5.0)
    assert abs(score.simulated - 100.0) < 1e-6
    np.testing.assert_allclose(output[:2].round(6) + score.shift, [5.0, 5.0])
