"""The score test: false alarms as rare as promised, and the unexplained part measured without bias."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, chi2

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import run_model
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.score_test import Explained, Residual
from replant.verdict.alternatives import Acting
from replant.verdict.evidence import Evidence, Runs
from replant.verdict.loop import Loop
from support.builders import G1, binary
from support.cases import every

DT, SAMPLES = 0.1, 1500
STRUCTURE = rp.Structure(1)
TRUE = np.array([0.5, 1.25])


def noise(seed: int, colour: float) -> np.ndarray:
    made = lfilter([1.0], [1.0, -colour], np.random.default_rng(seed).standard_normal(SAMPLES + 500))[500:]
    return np.asarray(made * np.sqrt(1.0 - colour**2))


def not_by_slopes(missed: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
    """What another choice of the coefficients, made by generalised least squares, leaves of a missed signal."""
    run = run_model(STRUCTURE, TRUE, Record(u, y, np.array([DT])), DT)
    assert run is not None
    whiten = Autoregression.of(run.error).whiten
    own = np.hstack([run.zeta, run.nuisances, np.ones((SAMPLES, 1))])
    return np.asarray(missed - own @ np.linalg.lstsq(whiten(own), whiten(missed), rcond=None)[0])


def part_of(
    y: np.ndarray,
    u: np.ndarray,
    used: np.ndarray | None = None,
    scale: float = 1.0,
    structure: rp.Structure = STRUCTURE,
) -> Explained:
    """What other dynamics could explain of the residual of the true model, as a part of the output's power."""
    model = TRUE * [1.0, scale] if structure is STRUCTURE else np.array([3.0, 3.0, 1.0, 1.0])
    record = Record(u, y, np.array([DT]), measured=used)
    evidence = Evidence(structure, DT, record, model, None, model, 0, u.size, in_sample=True, finished=True)
    runs = Runs.of(evidence)
    assert runs is not None
    return Acting.of(evidence, runs, Loop()).unexplained()


@every("colour", [0.9, 0.5, 0.0], quick=1)
def test_a_right_model_is_hardly_ever_accused(colour: float) -> None:
    """300 records of a known plant: by chance one of 33 such tables has an alarm, one of 2200 has two.

    The statistic has a mean of q degrees of freedom over a limit of chi2's 1 - alpha quantile, below 0.6 for q < 40.
    """
    statistics = []
    for seed in range(300):
        u = binary(seed, SAMPLES, 5)
        statistics.append(part_of(G1.simulate(u, DT) + 0.3 * noise(seed, colour), u).statistic)
    assert binom.sf(1, 300, ALPHA) < 1 / 2200
    assert np.count_nonzero(np.array(statistics) > 1.0) <= 1
    assert chi2.mean(40) / chi2.ppf(1 - ALPHA, 40) < 0.6
    assert np.mean(statistics) < 0.6


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_what_the_model_misses_is_measured_with_its_doubt(colour: float) -> None:
    """A second, faster mode is missing, of whose response the other coefficients can make up for a known part.

    Over 100 records the mean of the measured power of the rest is right within four standard errors and a tenth (the
    columns span such a response nearly), and the doubt of each within a half.
    """
    missing = rp.TransferFunction([1.0], [1.0, 3.0])
    found, expected = [], []
    for seed in range(100):
        u = binary(seed, SAMPLES, 5)
        missed = missing.simulate(u, DT)
        y = G1.simulate(u, DT) + missed + 0.3 * noise(seed, colour)
        part, whole = part_of(y, u), np.var(y)
        found.append((part.power * whole, part.std * whole, part.statistic))
        expected.append(np.var(not_by_slopes(missed, y, u)))
    powers, doubts, statistics = np.array(found).T
    error = powers - expected
    assert (statistics > 1.0).mean() > 0.9
    assert abs(error.mean()) < 4 * error.std() / 10 + 0.1 * np.mean(expected)
    assert 0.5 < error.std() / doubts.mean() < 1.5


def test_the_unit_of_the_output_does_not_matter() -> None:
    u = binary(1, SAMPLES, 5)
    y = G1.simulate(u, DT) + 0.3 * noise(1, 0.5) + 0.1 * np.roll(u, 7)
    part, other = part_of(y, u), part_of(1e6 * y, u, scale=1e6)
    assert other.statistic == pytest.approx(part.statistic, rel=1e-6)
    assert other.power == pytest.approx(part.power, rel=1e-6)


@every("seed", range(4), quick=2)
def test_a_direct_path_that_the_model_misses_is_measured(seed: int) -> None:
    """No input of the past tells it."""
    u = np.random.default_rng(seed).standard_normal(SAMPLES)
    missed = 0.1 * u
    y = G1.simulate(u, DT) + missed + 0.1 * noise(seed, 0.0)
    part, wanted = part_of(y, u), float(np.var(not_by_slopes(missed, y, u)) / np.var(y))
    assert part.is_sure
    assert part.power == pytest.approx(wanted, rel=0.2)


def test_feedback_is_no_fault_of_the_model() -> None:
    """The input answers to the noise that was: later inputs follow the residual, the model is right."""
    alarms = 0
    for seed in range(30):
        reference, e = binary(seed, SAMPLES, 20), 0.2 * noise(seed, 0.0)
        pole = np.exp(-0.5 * DT)
        x, u, y = 0.0, np.empty(SAMPLES), np.empty(SAMPLES)
        for k in range(SAMPLES):
            y[k] = x + e[k]
            u[k] = reference[k] - 0.5 * y[k - 1] if k else reference[k]
            x = pole * x + (1.0 - pole) * 2.5 * u[k]
        alarms += part_of(y, u).is_sure
    assert alarms == 0


@pytest.mark.parametrize("longest", [1, 10])
def test_missing_outputs_do_not_accuse_a_right_model(longest: int) -> None:
    """A fifth of the outputs is missing, the noise is slow: what is not known is not taken for a residual of zero."""
    statistics = []
    for seed in range(60):
        u, random = binary(seed, SAMPLES, 5), np.random.default_rng([seed, 1])
        used = np.ones(SAMPLES, bool)
        for begin in random.integers(0, SAMPLES, SAMPLES // (5 * longest)):
            used[begin : begin + longest] = False
        y = np.where(used, G1.simulate(u, DT) + 0.3 * noise(seed, 0.98), 0.0)
        statistics.append(part_of(y, u, used).statistic)
    assert max(statistics) < 1.0
    assert np.mean(statistics) < 0.6


def test_colour_that_the_noise_model_leaves_widens_the_limit() -> None:
    """1/f noise has more colour than four lags take: slow columns are explained by chance, the test allows for it."""
    alarms = 0
    for seed in range(60):
        spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal((2, SAMPLES)), axis=1)
        spectrum[:, 1:] /= np.arange(1, spectrum.shape[1])
        spectrum[:, 0] = 0.0
        slow, error = np.fft.irfft(spectrum, SAMPLES, axis=1)
        residual = Residual.of(error, np.zeros((SAMPLES, 0)), np.minimum(np.arange(SAMPLES), 4), np.ones(SAMPLES, bool))
        alarms += residual.explained(np.column_stack([slow, np.roll(slow, 40)])).is_sure
    assert alarms <= 1


def test_what_is_known_is_never_explained_again() -> None:
    columns = np.random.default_rng(1).standard_normal((SAMPLES, 3))
    error = columns @ [1.0, 2.0, 3.0] + noise(1, 0.5)
    residual = Residual.of(error, columns, np.minimum(np.arange(SAMPLES), 4), np.ones(SAMPLES, bool))
    assert residual.explained(columns @ [[1.0], [1.0], [0.0]]).statistic == 0.0


def test_few_samples_take_few_columns() -> None:
    u = binary(1, 120, 5)
    assert np.isfinite(part_of(np.cumsum(u), u, structure=rp.Structure(3)).statistic)


def test_nothing_left_is_nothing_to_explain() -> None:
    u = binary(1, SAMPLES, 5)
    assert part_of(np.zeros(SAMPLES), np.zeros(SAMPLES) + u, scale=0.0).statistic == 0.0


def test_what_is_explained_to_the_last_bit_is_no_chance_and_has_no_scatter() -> None:
    """Of a residual so small that the square of what is left is zero, nothing is divided by that."""
    column = np.random.default_rng(0).choice([-1.0, 1.0], 400)
    for scale in (1.0, 1e-158):
        residual = Residual.of(
            scale * column, np.zeros((400, 0)), np.minimum(np.arange(400), 50), np.ones(400, dtype=bool)
        )
        found = residual.explained(column[:, None])
        assert found.weights == pytest.approx([scale])
        assert found.power == pytest.approx(scale**2 * column.var(), rel=1e-3)
        assert found.std < 1e-9 * scale
        assert found.statistic > 1e9
