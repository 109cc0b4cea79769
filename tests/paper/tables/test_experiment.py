"""One experiment: its simulated record and its indices, against naive NumPy twins."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from replant import AMSGrad
from replant.paper.tables import TABLES, Plant, run_seeds


def run(experiment, seed=0):
    """Return the indices of one run."""
    (indices,) = run_seeds(experiment, [seed])
    return indices


def simulated(num, den, u, dt):
    """Return Tustin's output sample by sample, from SciPy's own discretisation."""
    from scipy.signal import cont2discrete, tf2ss

    A, B, C, D, _ = cont2discrete(tf2ss(num, den), dt, "gbt", alpha=0.5)
    x, y = np.zeros(A.shape[0]), np.empty(u.size)
    for k in range(u.size):
        y[k] = C[0] @ x + D[0, 0] * u[k]
        x = A @ x + B[:, 0] * u[k]
    return y


def indices_of_g1(u, y, optimizer):
    """Return J of a0 and b0 in the article's own words: (6)-(8), (11)-(14), (17) or Algorithm 2, (21), for G1."""
    dt, cutoff, sigma_y, sigma = 1e-3, 5.0, 0.25, np.array([0.05, 0.15])
    advance = (1 - dt * cutoff / 2) / (1 + dt * cutoff / 2)
    inject = dt / (1 + dt * cutoff / 2)
    omega, theta = np.zeros(2), np.array([-cutoff, 0.0]) * sigma / sigma_y
    m = v = largest = np.zeros(2)
    J = np.zeros(2)
    for k in range(u.size):
        J += (theta * sigma_y / sigma + [cutoff, 0.0] - [0.5, 1.25]) ** 2
        phi = omega / sigma
        g = -(y[k] / sigma_y - theta @ phi) / (1 + phi @ phi) * phi
        if isinstance(optimizer, AMSGrad):
            m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
            largest = np.maximum(largest, v)
            theta = theta - optimizer.step_size * m / (np.sqrt(largest) + 1e-8)
        else:
            theta = theta - dt * optimizer.gain * g
        omega = advance * omega + inject * np.array([-y[k], u[k]])
    return J


@pytest.mark.parametrize("table", ["table1", "table3"])
def test_the_record_is_tustins_response(table):
    plant = dataclasses.replace(TABLES[table].rows[0].experiment.plant, duration=2.0, period=0.5)
    u, y = plant.record()
    expected = simulated(plant.num, plant.den, u, plant.dt)
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12 * abs(expected).max())


def test_the_square_wave_starts_high_and_switches_every_half_period():
    u, _ = Plant((1.25,), (1.0, 0.5), dt=1e-3, duration=10.0, period=1.25, amplitude=3.0).record()
    assert u.size == 10_000
    assert (u[:625] == 3.0).all()
    assert (u[625:1250] == -3.0).all()
    np.testing.assert_array_equal(u[1250:], u[:-1250])


def test_the_drift_is_added_to_the_output():
    plant = TABLES["table4"].row("with").experiment.plant
    u, y = plant.record()
    clean_u, clean_y = dataclasses.replace(plant, drift=0.0).record()
    np.testing.assert_array_equal(u, clean_u)
    # the article: "for t = 60 disturbance has value 0.25"
    assert (y - clean_y)[-1] == pytest.approx(0.25, abs=1e-4)
    np.testing.assert_allclose(y - clean_y, 0.004166 * np.arange(60_000) * 1e-3, rtol=0, atol=1e-12)


@pytest.mark.parametrize("label", ["AMSGrad, no buffer", "Gradient, no buffer"])
def test_indices_equal_a_naive_twin(label):
    experiment = TABLES["table1"].row(label).experiment
    u, y = experiment.plant.record()
    indices = run(experiment)
    expected = indices_of_g1(u, y, experiment.optimizer)
    assert [indices["J_a0"], indices["J_b0"]] == pytest.approx(expected, rel=1e-9)
    assert indices["J_sum"] == pytest.approx(expected.sum(), rel=1e-9)


def test_the_bias_has_no_index():
    assert list(run(TABLES["table4"].row("with").experiment)) == ["J_a0", "J_b0", "J_sum"]


def test_the_seed_decides_a_run_with_a_buffer_and_no_other():
    buffered = TABLES["table1"].row("AMSGrad, with buffer (batch 10)").experiment
    plain = TABLES["table1"].row("AMSGrad, no buffer").experiment
    assert run(buffered, 7) == run(buffered, 7)
    assert run(buffered, 7) != run(buffered, 8)
    assert run(plain, 7) == run(plain, 8)


def test_importing_the_package_imports_nothing_heavy():
    code = (
        "import sys, replant.paper, replant.cli.demo\n"
        "print([name for name in ('scipy', 'matplotlib', 'rich') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
