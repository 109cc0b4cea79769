"""Views: they agree with their identifier, lose no peak, and claim nothing before the first model."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

import replant as rp
from replant.estimation.simulation.fitted_run import FittedRun
from replant.live.make_view import POINTS, EstimateHistory, make_view
from replant.live.outputs.message import UNKNOWN
from replant.live.streams import Signals
from replant.live.streams.demo import simulated
from replant.live.view import SessionInfo, View
from replant.rigs import deap_rig
from replant.verdict import simulate
from replant.verdict.estimate_tests import are_known
from support.cases import every
from support.live_fakes import DT, PLANT, REQUEST, record
from support.live_views import resting_view, viewed


def test_a_view_agrees_with_its_identifier() -> None:
    u, y = record()
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y)
    found = viewed(u.size)
    np.testing.assert_array_equal(found.parameters, identifier.parameters)
    np.testing.assert_array_equal(found.std, identifier.uncertainty.std)
    assert found.poles == [-identifier.parameters[0]]
    assert found.pole_covariance[0, 0, 0] == pytest.approx(identifier.covariance[0, 0])
    assert found.dc_gain == pytest.approx(identifier.parameters[1] / identifier.parameters[0])
    verdict = identifier.assess()
    assert (found.verdict, found.excited, found.reasons) == (verdict.status, verdict.excited, verdict.reasons)
    response = PLANT.response(found.bode.omega)
    np.testing.assert_allclose(found.bode.magnitude_db, 20 * np.log10(np.abs(response)), atol=0.2)
    assert (found.bode.magnitude_low < found.bode.magnitude_db).all()
    assert (found.bode.magnitude_db < found.bode.magnitude_high).all()


def test_the_newest_samples_are_simulated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    runs, take = [], FittedRun.take
    monkeypatch.setattr(FittedRun, "take", lambda self, u, *more: (runs.append(u.size), take(self, u, *more))[1])
    view = viewed(900)
    assert runs == [900]
    assert view.model["fit"]["simulated"] == view.simulated


def test_the_window_shows_the_newest_samples_in_their_own_units() -> None:
    u, y = record(900)
    window = viewed(900).window
    np.testing.assert_allclose(window.t, DT * np.arange(1, 901), atol=1e-9)
    np.testing.assert_allclose(window.u, u)
    np.testing.assert_allclose(window.y, y)
    assert np.std(window.model - y) < 0.05  # the model runs through the measured output, working point included


def after_a_stuck_sensor(samples: int) -> tuple[rp.Identifier, View]:
    """Seen after so many samples, of which 1500 to 2000 stood still and 2600 was an outlier."""
    u, y = record(4000)
    y[1500:2000] = y[1500]
    y[2600] += 50.0
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u[:samples], y[:samples])
    return identifier, make_view(identifier, SessionInfo(at=samples * DT), EstimateHistory(2))


@pytest.mark.slow
@every("samples", [1900, 2050, 2500, 3000, 4000])
def test_samples_that_were_bridged_take_no_part_in_the_fit_that_is_shown(samples: int) -> None:
    identifier, view = after_a_stuck_sensor(samples)
    u, y, _ = identifier.recent.T
    bridged = identifier.bridged
    assert bridged[1500:2000][: samples - 1500].mean() > 0.9
    assert view.simulated > 95.0  # with them it is below 80, and below 0 while they last
    run = simulate(identifier.transfer_function, u - 3.0, np.where(identifier.judged, y, np.nan), DT)
    assert view.simulated == pytest.approx(run.fit)


def test_what_is_left_out_is_told_by_when_it_came() -> None:
    samples = 3000
    identifier, view = after_a_stuck_sensor(samples)
    told = np.zeros(samples, bool)
    for begin, end in view.window.left_out:
        told[round(begin / DT) : round(end / DT)] = True
    np.testing.assert_array_equal(told, ~identifier.judged)
    assert view.to_json()["window"]["left_out"][0][1] == pytest.approx(2000 * DT)
    assert after_a_stuck_sensor(1400)[1].window.left_out.size == 0


def test_verdict_and_fit_agree_once_the_sensor_is_free() -> None:
    verdicts = [after_a_stuck_sensor(samples)[1].verdict for samples in (1400, 1900, 4000)]
    assert verdicts == ["trusted", "inconsistent", "trusted"]


def test_a_model_is_trusted_while_the_input_rests_and_the_view_says_both() -> None:
    found = resting_view()
    assert (found.verdict, found.excited) == ("trusted", False)
    assert viewed(3000).excited


def test_coefficients_are_not_known_where_the_verdict_relies_on_the_response_alone() -> None:
    """The slow pole of the actuator, of 10 s, is not told from a zero within 0.8 s, and is within 20 s."""
    _, u, y = next(simulated(seed=0))
    identifier = rp.Identifier(rp.Structure(3, 1), 0.001, preprocess=rp.Preprocess("square", "mean", "mean"))
    told = {}
    for begin, end in ((0, 800), (800, 20_000)):
        identifier.update_many(u[begin:end], y[begin:end])
        view = make_view(identifier, SessionInfo(), EstimateHistory(5))
        relies = any("rely on G(s)" in reason for reason in view.reasons)
        far = np.abs(view.parameters[2] / deap_rig().plant.den[3] - 1.0) > 0.3
        told[end] = view.verdict, relies, view.coefficients, bool(far)
    assert told == {800: ("trusted", True, False, True), 20_000: ("trusted", False, True, False)}


@every(
    ("numerator", "std", "known"),
    [
        ((3.0, 6.0), (0.1, 0.2), True), ((3.0, 6.0), (0.1, 30.0), False), ((3.0, 6.0), (15.0, 0.2), False),
        ((0.001, 6.0), (0.005, 0.2), True),  # a surplus zero: that b1 is small is known
        ((0.001, 6.0), (5.0, 0.2), False), ((0.001, 6.0), (0.005, 1.2), False),
        ((5.0, 0.5), (0.1, 0.4), False), ((5.0, 0.5), (0.1, 0.05), True), ((0.0, 0.0), (0.1, 0.1), False),
    ],
)  # fmt: skip
def test_coefficients_are_known_only_with_those_of_the_numerator(
    numerator: tuple[float, float], std: tuple[float, float], known: bool
) -> None:
    """A pole at 1 and one at 4 rad/s, known to 2 %; the units of time and of the output do not matter."""
    for rate, gain in itertools.product((1.0, 1e-3), repeat=2):
        scales = np.array([rate, rate**2, gain * rate, gain * rate**2])
        parameters, deviations = (scales * np.array(each) for each in ((5.0, 4.0, *numerator), (0.1, 0.08, *std)))
        assert are_known(rp.Structure(2, 1), parameters, deviations, 100.0 / rate) == known


def test_a_view_without_a_verdict_claims_no_excitation() -> None:
    found = viewed(3000).unjudged("nobody looked")
    assert (found.verdict, found.excited, found.reasons) == ("unknown", False, ("nobody looked",))


def test_a_long_window_is_thinned_and_loses_no_peak() -> None:
    u, y = record(5000)
    y[3210] += 20.0
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y)
    window = make_view(identifier, SessionInfo(at=250.0), EstimateHistory(2)).window
    assert window.t.size == window.u.size == window.y.size == window.model.size <= POINTS
    assert window.y.max() == y.max()
    peak = int(np.argmax(window.y))
    assert window.t[peak] == pytest.approx(3211 * DT, abs=10 * DT)
    assert (np.diff(window.t) > 0).all()
    assert window.t[-1] == pytest.approx(250.0, abs=10 * DT)


def test_stamps_with_jitter_are_simulated_as_they_came() -> None:
    t = DT * (np.arange(1, 1501) + 0.3 * np.random.default_rng(0).uniform(-1, 1, 1500))
    found = viewed(900, t=tuple(t[:900]))
    assert np.isfinite(found.simulated)
    assert np.ptp(np.diff(found.window.t)) > 0.1 * DT
    np.testing.assert_allclose(found.window.t - found.window.t[-1], t[:900] - t[899], atol=1e-9)


@pytest.mark.parametrize("samples", [0, 1, 20])
def test_before_the_first_model_nothing_is_claimed(samples: int) -> None:
    found = viewed(samples)
    assert found.status == "starting"
    assert np.isnan(found.parameters).all()
    assert np.isnan(found.std).all()
    assert found.den.size == found.num.size == found.poles.size == found.bode.omega.size == 0
    assert found.window.y.size == samples
    assert np.isnan(found.window.model).all()


def test_a_provisional_model_is_shown_as_what_it_is() -> None:
    found = viewed(150)
    assert (found.status, found.verdict) == ("starting", "converging")
    assert "provisional" in found.reasons[1]
    assert np.isfinite(found.parameters).all()
    assert np.isfinite(found.window.model).all()
    assert found.den.size == found.poles.size + 1
    assert found.bode.omega.size > 0


@pytest.mark.parametrize("samples", [0, 150, 1000])
def test_a_view_is_json_under_its_own_names(samples: int) -> None:
    found = viewed(samples, rp.Structure(3, 1))
    plain = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert set(plain) == set(vars(found))
    assert set(plain["window"]) == {"t", "u", "y", "r", "model", "residual", "left_out"}
    assert set(plain["history"]) == {"t", "parameters", "std"}
    assert len(plain["parameters"]) == found.parameters.size
    if found.poles.size:
        assert plain["poles"][0] == {"real": found.poles[0].real, "imag": found.poles[0].imag}
    else:
        assert plain["parameters"][0] is None


def test_poles_come_in_pairs_with_mirrored_covariances() -> None:
    u = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 400), 5)
    plant = rp.TransferFunction([4.0], [1.0, 1.0, 4.0])
    y = plant.simulate(u, DT) + 0.01 * np.random.default_rng(3).standard_normal(u.size)
    identifier = rp.Identifier(**{**vars(REQUEST), "structure": rp.Structure(2)})
    identifier.update_many(u, y)
    found = make_view(identifier, SessionInfo(), EstimateHistory(3))
    assert found.poles[0] == found.poles[1].conjugate()
    np.testing.assert_allclose(found.poles, [-0.5 + 1.936j, -0.5 - 1.936j], atol=0.02)
    first, second = found.pole_covariance
    np.testing.assert_allclose(np.diag(first), np.diag(second))
    assert first[0, 1] == -second[0, 1]


def test_the_model_to_be_kept_has_the_working_point_of_the_rig() -> None:
    """The window is drawn over the input as it is, the model acts on deviations from its level."""
    u = 5.0 + np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 60), 25)
    y = 30.0 + rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u - 5.0, 0.1)
    ident = rp.Identifier(poles=1, dt=0.1, preprocess=rp.Preprocess("identity", "mean", "mean"))
    ident.update_many(u, y)
    view = make_view(ident, SessionInfo(), EstimateHistory(2))
    kept = rp.Model.from_json(json.dumps(view.model))
    assert kept == ident.model
    assert abs(kept.simulate(np.full(3, 5.0))[0] - 30.0) < 0.1


def lightly_damped(u: np.ndarray, dt: float) -> tuple[rp.Identifier, rp.TransferFunction]:
    """A plant with a slow mode and a resonance of 1 % damping, and an identifier that has learned it."""
    plant = rp.TransferFunction([400.0, 100.0], np.polymul([1.0, 0.1], [1.0, 0.4, 400.0]))
    y = plant.simulate(u, dt) + 1e-3 * np.random.default_rng(3).standard_normal(u.size)
    identifier = rp.Identifier(rp.Structure(3, 1), dt)
    identifier.update_many(u, y)
    return identifier, plant


def test_bode_and_step_show_a_resonance_and_the_truth_beside_it() -> None:
    u = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 800), 5)
    identifier, plant = lightly_damped(u, 0.02)
    view = make_view(identifier, SessionInfo(at=80.0), EstimateHistory(5), truth=plant)
    model = identifier.transfer_function
    near = np.linspace(18.0, 22.0, 20_001)
    peak = 20 * np.log10(np.abs(model.response(near)).max())
    shown = (view.bode.omega > 18.0) & (view.bode.omega < 22.0)
    assert view.bode.magnitude_db[shown].max() == pytest.approx(peak, abs=0.1)  # of equally spaced ones: 4 dB
    assert (np.diff(view.bode.omega) > 0).all()
    assert view.truth is not None
    np.testing.assert_allclose(view.truth.parameters, [*plant.den[1:], *plant.num])
    np.testing.assert_allclose(view.truth.magnitude_db, 20 * np.log10(np.abs(plant.response(view.bode.omega))))
    assert view.step.t.size == view.step.y.size == view.truth.step.size
    early = (view.step.t > 0.0) & (view.step.t < 1.0)
    exact = np.array([plant.simulate(np.ones(2), t)[1] for t in view.step.t[early]])
    assert early.sum() > 2 * 1.0 * 20.0 / 6.28  # the oscillation is seen, not its aliases
    np.testing.assert_allclose(view.truth.step[early], exact, rtol=1e-6)
    assert (view.step.low <= view.step.y).all()
    assert (view.step.y <= view.step.high).all()


def test_without_a_known_plant_there_is_no_truth_and_of_another_structure_no_true_coefficients() -> None:
    u = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 200), 5)
    identifier, plant = lightly_damped(u, 0.02)
    assert make_view(identifier, SessionInfo(), EstimateHistory(5)).truth is None
    other = rp.Identifier(rp.Structure(1), 0.02)
    other.update_many(u, plant.simulate(u, 0.02))
    truth = make_view(other, SessionInfo(), EstimateHistory(2), truth=plant).truth
    assert truth is not None
    assert np.isnan(truth.parameters).all()
    assert truth.poles.size == 3


def test_the_residual_is_measured_minus_simulated_and_leaves_out_what_is_bridged() -> None:
    identifier, view = after_a_stuck_sensor(900)
    np.testing.assert_allclose(view.window.residual, view.window.y - view.window.model)
    assert view.residual_std == pytest.approx(np.nanstd(view.window.residual), rel=0.3)
    identifier, _ = after_a_stuck_sensor(1800)
    short = make_view(identifier, SessionInfo(), EstimateHistory(2)).window
    assert np.isnan(short.residual).any()
    assert np.isnan(viewed(20).residual_std)


def test_the_newest_part_of_a_long_window_can_be_looked_at_alone() -> None:
    u, y = record(5000)
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y)
    t = make_view(identifier, SessionInfo(at=250.0), EstimateHistory(2)).window.t
    assert (t > 240.0).sum() == pytest.approx(10.0 / DT, abs=5)  # every sample
    assert t.size <= POINTS


def test_the_mapped_input_is_named() -> None:
    squared = rp.Identifier(rp.Structure(1), DT, preprocess=rp.Preprocess("square"))
    view = make_view(squared, SessionInfo(), EstimateHistory(2), signals=Signals(("voltage [kV]",), "way [mm]"))
    assert (view.input_label, view.output_label) == ("voltage² [kV²]", "way [mm]")
    assert viewed(20).input_label == "input"


def test_a_view_that_is_not_judged_trusts_nothing_and_its_model_does_not_either() -> None:
    view = viewed(800).unjudged("nobody looks")
    assert (view.verdict, view.excited, view.reasons) == (UNKNOWN, False, ("nobody looks",))
    assert view.model["verdict"] == {"status": "converging", "excited": False, "reasons": ["nobody looks"]}
