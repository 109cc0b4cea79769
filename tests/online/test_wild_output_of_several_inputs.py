"""A wild output moves the recursive estimate of several inputs by no more than an outlier may."""

import numpy as np
import pytest

import replant as rp
from support.cases import every

SIZE, AT = 13000, 11000  # behind the last solution of the record


def identified(wild, seed):
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (SIZE // 20, 2)).repeat(20, axis=0)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u[:, 0].copy(), dt=0.1)
    y += rp.TransferFunction([1.0], [1.0, 3.0], delay=0.3).simulate(u[:, 1].copy(), dt=0.1)
    y += rng.normal(0.0, 0.1, SIZE)
    for place, amplitude in wild.items():
        y[place] += amplitude
    ident = rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1)
    ident.update_many(u, y)
    return ident


@pytest.mark.slow
@every("amplitude", [10.0, -1e3, 1e6, 1e12], quick=1)
def test_the_estimate_moves_by_less_than_a_standard_deviation(amplitude):
    clean, hit = identified({}, 5), identified({AT: amplitude, AT + 40: -amplitude}, 5)
    std = np.sqrt(np.diag(clean.covariance))
    assert np.all(np.abs(hit.parameters - clean.parameters) < std)
    np.testing.assert_allclose(np.sqrt(np.diag(hit.covariance)), std, rtol=0.05)
    assert hit.assess().status == "trusted"
