"""The same samples are left out, and the same estimate comes out, whoever is asked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.numerics.robust import flags_of

PLANT, DT, SAMPLES = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), 0.05, 2000


def damaged(how: str) -> tuple[np.ndarray, np.ndarray]:
    """A record, and which of its outputs are bad."""
    random = np.random.default_rng(11)
    u = np.repeat(random.choice([-1.0, 1.0], SAMPLES // 8), 8)
    y = PLANT.simulate(u, DT)
    y += 0.03 * y.std() * random.standard_normal(SAMPLES)
    bad = np.zeros(SAMPLES, bool)
    if how == "stuck":
        bad[901:1300] = True
        y[900:1300] = y[900]
    elif how == "outliers":
        bad[random.choice(SAMPLES, 15, replace=False)] = True
        y[bad] += random.choice([-1.0, 1.0], 15) * random.uniform(3.0, 50.0, 15) * y.std()
    else:
        bad[300:340] = bad[1500:1580] = True
        y[bad] = np.nan
    return np.column_stack([u, y]), bad


@pytest.mark.parametrize("how", ["stuck", "outliers", "missing"])
def test_fit_run_and_fleet_leave_out_the_same_samples(how: str, tmp_path: Path) -> None:
    signals, bad = damaged(how)
    path = tmp_path / "rig.csv"
    rows = [f"{DT * k!r},{u!r},{'' if np.isnan(y) else repr(float(y))}" for k, (u, y) in enumerate(signals.tolist())]
    path.write_text("\n".join(["t,u,y", *rows]))
    log = rp.read_log(path, input="u", output="y")
    fitted, run = rp.fit(log, poles=2), rp.run(log, poles=2)
    left_out = np.zeros(SAMPLES, bool)
    left_out[np.concatenate([fitted.outliers, fitted.stuck, fitted.missing])] = True
    assert not (bad & ~left_out).any()
    assert int(left_out.sum()) <= int(bad.sum()) + 1  # the first output of a stuck stretch was measured
    np.testing.assert_array_equal(flags_of(run.left_out, 0, SAMPLES), left_out)
    np.testing.assert_allclose(run.model.parameters, fitted.parameters, rtol=1e-9)
    for method in ("run", "fit"):
        fleet = rp.fleet.fit(
            tmp_path, by="file", out=tmp_path / "out" / method, method=method, input="u", output="y", poles=2
        )
        np.testing.assert_allclose(fleet.model("rig.csv").parameters, fitted.parameters, rtol=1e-9)
    assert (run.verdict.status, run.simulation.fit) == (fitted.verdict.status, pytest.approx(fitted.simulation.fit))
    for reason in ("outlier", "stuck"):
        assert run.rejected[reason] == fitted.rejected[reason]


@pytest.mark.parametrize("samples", [400, SAMPLES])  # in the start-up, and behind it
def test_a_long_gap_parts_a_finished_run_as_it_parts_a_fit(samples: int) -> None:
    u, y = damaged("outliers")[0].T
    kept = (np.arange(SAMPLES) < 30) | (np.arange(SAMPLES) >= 150)
    kept &= np.arange(SAMPLES) < samples
    u, y, t = u[kept], y[kept], DT * np.arange(SAMPLES)[kept]
    fitted = rp.fit(u, y, DT, poles=2, t=t)
    ident = rp.Identifier(rp.Structure(2), DT)
    ident.update_many(u, y, t)
    ident.finish()
    np.testing.assert_allclose(ident.parameters, fitted.parameters, rtol=1e-9)
    assert (ident.assess().status, ident.assess().samples) == (fitted.verdict.status, fitted.verdict.samples)


def test_finish_takes_what_fit_finds_unless_the_present_estimate_is_likelier_beyond_chance() -> None:
    random = np.random.default_rng(14)  # a surplus pole and zero: no solution is certain, and the two are as likely
    u = np.repeat(random.choice([-1.0, 1.0], 391), 8)
    y = rp.TransferFunction([1.0], [1.0, 1.0]).simulate(u, DT) + 0.02 * random.standard_normal(u.size)
    identifier = rp.Identifier(rp.Structure(2, 1), DT)
    identifier.update_many(u, y)
    present, fitted = identifier.parameters.copy(), rp.fit(u, y, DT, poles=2, zeros=1)
    assert np.abs(present / fitted.parameters - 1.0).max() > 1e-3
    identifier.finish()
    np.testing.assert_allclose(identifier.parameters, fitted.parameters, rtol=1e-6)
