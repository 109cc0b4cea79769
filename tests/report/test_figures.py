"""The data behind the axes are those of the result, bands appear where a covariance is known, and nothing else does."""

import dataclasses
import math

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.signal import lfilter

import replant as rp
from replant.errors import InvalidArgumentError
from replant.model.noise import NoiseModel
from replant.model.uncertainty import Uncertainty
from replant.numerics.residuals import BAND_95, BAND_99, correlations
from replant.plotting.over_time import SHOWN
from replant.report.figures import (
    draw_bode,
    draw_correlations,
    draw_excitation,
    draw_fit,
    draw_outputs,
    draw_overlay,
    draw_poles_and_zeros,
    draw_responses,
    draw_spectrum,
    draw_step,
    draw_transients,
    save_figures,
    style,
)
from replant.report.findings import excitation
from replant.report.panels import regions, zero_covariance
from support.builders import with_model
from support.cases import every


def curves(axis) -> dict[str, np.ndarray]:
    return {line.get_label(): np.column_stack(line.get_data()) for line in axis.lines}


def bands(axis) -> int:
    return sum(patch.get_label() == "± 2σ" for patch in axis.collections)


def record(case) -> tuple:
    return case.result, case.log.input, case.log.output, case.log.dt


def test_fit_shows_record_model_and_residual(plain) -> None:
    result, u, y, dt = record(plain)
    model = result.simulation.output[:2000]
    short = dataclasses.replace(result, simulation=dataclasses.replace(result.simulation, output=model))
    labels = {"input_label": "voltage [V]", "output_label": "speed [rpm]"}
    top, middle, bottom = draw_fit(short, u[:2000], y[:2000], dt, **labels)
    assert (top.get_ylabel(), middle.get_ylabel(), bottom.get_ylabel()) == (
        "voltage [V]", "speed [rpm]", "residual [rpm]",
    )  # fmt: skip
    assert bottom.get_xlabel() == "time [s]"
    np.testing.assert_array_equal(curves(middle)["measured"], np.column_stack([dt * np.arange(2000), y[:2000]]))
    np.testing.assert_array_equal(curves(middle)["model, from the input alone"][:, 1], model)
    np.testing.assert_array_equal(bottom.lines[0].get_ydata(), y[:2000] - model)
    with pytest.raises(InvalidArgumentError, match="4000"):
        draw_fit(result, u[:2000], y[:2000], dt)


def test_what_is_left_out_is_shaded_and_has_no_residual(plain) -> None:
    result, u, y, dt = record(plain)
    left_out = np.array([[100, 300], [2000, 2001]])
    axes = draw_fit(dataclasses.replace(result, left_out=left_out), u, y, dt)
    for axis in axes:
        (shade,) = (patch for patch in axis.collections if patch.get_label() == "left out")
        spans = [(path.vertices[:, 0].min(), path.vertices[:, 0].max()) for path in shade.get_paths()]
        np.testing.assert_allclose(spans, dt * (left_out - [1, 0]))
    assert np.isnan(axes[-1].lines[0].get_ydata()).any()
    whole = draw_fit(dataclasses.replace(result, left_out=left_out[:0]), u, y, dt)
    assert all(patch.get_label() != "left out" for axis in whole for patch in axis.collections)


def test_fit_is_thinned_without_losing_a_peak(long_case) -> None:
    result, u, y, dt = record(long_case)
    _, middle, _ = draw_fit(result, u, y, dt)
    drawn = curves(middle)["measured"]
    assert drawn.shape[0] <= SHOWN
    assert np.nanmax(drawn[:, 1]) == np.nanmax(y) == 9.5


def test_model_that_leaves_the_picture_does_not_squeeze_the_measurement(plain) -> None:
    result, u, y, dt = record(plain)
    wild = dataclasses.replace(result, simulation=rp.verdict.Simulation(np.geomspace(1.0, 1e200, y.size), 0.0, -np.inf))
    _, middle, bottom = draw_fit(wild, u, y, dt)
    assert np.ptp(middle.get_ylim()) < 4 * np.ptp(y)
    assert np.ptp(bottom.get_ylim()) < 5 * np.ptp(y)


def test_transients_hold_the_history_and_the_truth(plain) -> None:
    result, _, _, dt = record(plain)
    true = [1.6, 4.0, 3.0, 6.0]
    axes = draw_transients(result, dt, truth=true, input_label="u [V]", output_label="y [m]")
    assert [axis.get_title("left") for axis in axes] == ["a₁ [1/s]", "a₀ [1/s²]", "b₁ [m/V/s]", "b₀ [m/V/s²]"]
    for i, axis in enumerate(axes):
        drawn = curves(axis)
        assert drawn["estimate"][-1, 1] == pytest.approx(result.history.parameters[-1, i], abs=0.02)
        assert set(drawn["true"][:, 1]) == {true[i]}
        assert bands(axis) == 0
        low, high = axis.get_ylim()
        assert low < true[i] < high


def test_no_estimate_is_drawn_before_there_is_one(plain) -> None:
    result, _, _, dt = record(plain)
    held = int((result.history.parameters != 0.0).any(axis=1).argmax())
    assert held == 49  # an eighth of a tenth of the record went into the first, provisional estimate
    for axis in draw_transients(result, dt):
        t, values = curves(axis)["estimate"].T
        assert np.isnan(values[t < 49 * dt]).all()
        assert np.isfinite(values[t > 51 * dt]).all()
    never = dataclasses.replace(
        result, history=dataclasses.replace(result.history, parameters=0 * result.history.parameters)
    )
    assert [axis.texts[0].get_text() for axis in draw_transients(never, dt)] == ["no estimate"] * 4


def test_transients_are_banded_by_two_standard_deviations(uncertain) -> None:
    result, _, _, dt = record(uncertain)
    known = (result.history.parameters != 0.0).any(axis=1)
    parameters, std = result.history.parameters[known], result.history.std[known]
    for i, axis in enumerate(draw_transients(result, dt)):
        assert bands(axis) == 1
        outline = axis.collections[0].get_paths()[0].vertices
        high, low = parameters[:, i] + 2 * std[:, i], parameters[:, i] - 2 * std[:, i]
        assert outline[:, 1].max() == pytest.approx(high.max())
        assert outline[:, 1].min() == pytest.approx(low.min())


def test_poles_and_zeros_are_those_of_the_model(plain, uncertain) -> None:
    for case in (plain, uncertain):
        axis = draw_poles_and_zeros(case.result)
        drawn = curves(axis)
        model = case.result.transfer_function
        np.testing.assert_array_equal(drawn["poles"], np.column_stack([model.poles.real, model.poles.imag]))
        np.testing.assert_array_equal(drawn["zeros"], np.column_stack([model.zeros.real, model.zeros.imag]))
        left, right = axis.get_xlim()
        assert left < model.poles.real.min() < 0 < right
        labels = {text.get_text() for text in axis.get_legend().get_texts()}
        assert ("95 % region" in labels) == (case is uncertain)


def test_ellipses_hold_95_percent_of_the_poles_drawn_from_the_covariance(uncertain) -> None:
    result = with_model(uncertain.result, covariance=uncertain.result.covariance / 100)  # where it is linear
    pole, covariance = next((root, known) for root, known in regions(result.model) if root.imag > 0)
    drawn = np.random.default_rng(0).multivariate_normal(result.parameters, result.covariance, 4000)
    upper = np.array([max(np.roots([1.0, *row[:2]]), key=lambda root: root.imag) for row in drawn])
    off = np.column_stack([upper.real - pole.real, upper.imag - pole.imag])
    inside = np.einsum("ki,ij,kj->k", off, np.linalg.inv(covariance), off) < 2.448**2
    assert inside.mean() == pytest.approx(0.95, abs=0.015)


def test_covariance_of_zeros_is_that_of_numerical_derivatives() -> None:
    num, covariance = np.array([2.0, 3.0, 5.0]), np.diag([0.01, 0.04, 0.09]) + 0.005
    zero = np.roots(num)[0]
    step = 1e-6
    slopes = []
    for i in range(3):
        moved = num.copy()
        moved[i] += step
        slopes.append((min(np.roots(moved), key=lambda root: abs(root - zero)) - zero) / step)
    parts = np.array([np.real(slopes), np.imag(slopes)])
    np.testing.assert_allclose(zero_covariance(num, covariance, zero), parts @ covariance @ parts.T, rtol=1e-4)


@pytest.mark.filterwarnings("error")
def test_double_pole_and_unknown_covariance_have_no_region(uncertain) -> None:
    double = np.array([4.0, 4.0, 1.0, 3.0])  # (s + 2)^2
    result = with_model(uncertain.result, parameters=double)
    unknown = with_model(result, covariance=np.full((4, 4), np.nan))
    for each in (result, unknown):
        axis = draw_poles_and_zeros(each)
        draw_bode(each, 0.05)
        assert len(curves(axis)["poles"]) == 2
    assert regions(unknown.model) == []


def test_bode_holds_the_response_and_its_band(uncertain) -> None:
    result, _, _, dt = record(uncertain)
    top, bottom = draw_bode(result, dt, input_label="voltage [V]", output_label="speed [rpm]")
    assert (top.get_ylabel(), bottom.get_xlabel()) == ("magnitude [dB re rpm/V]", "frequency [rad/s]")
    omega, magnitude = top.lines[0].get_data()
    assert omega.max() <= math.pi / dt * 1.001
    response = result.transfer_function.response(omega)
    np.testing.assert_allclose(magnitude, 20 * np.log10(abs(response)))
    np.testing.assert_allclose(np.exp(1j * np.radians(bottom.lines[0].get_data()[1])), response / abs(response))
    outline = top.collections[0].get_paths()[0].vertices
    relative, _ = Uncertainty(result.structure, result.parameters, result.covariance).response(omega)
    assert outline[:, 1].max() == pytest.approx((magnitude + 2 * 20 / math.log(10) * relative).max())


def test_correlations_are_drawn_with_both_limits(plain) -> None:
    residual = plain.log.output - plain.result.simulation.output
    found = correlations(residual, plain.log.input, 50)
    left, right = draw_correlations(found, plain.log.dt)
    for axis, values, std in ((left, found.auto, found.auto_std), (right, found.cross, found.cross_std)):
        drawn = np.concatenate([line.get_ydata() for line in axis.lines])
        assert np.isin(values, drawn).all()
        reach = sorted(patch.get_height() / 2 for patch in axis.patches)
        assert reach == pytest.approx([BAND_95 * std, BAND_99 * std])
        assert axis.get_xlabel() == "lag [s]"


def test_limits_can_be_seen_beside_a_white_residual() -> None:
    noise = np.random.default_rng(3).standard_normal((2, 20_000))
    white, coloured = (
        draw_correlations(correlations(e, noise[1], 200), 0.1)[0] for e in (noise[0], np.cumsum(noise[0]))
    )
    reach = white.get_ylim()[1]
    assert 2.576 / np.sqrt(20_000) < reach < 0.06
    assert coloured.get_ylim()[1] >= 1.0


def test_the_spectrum_of_coloured_noise_and_of_its_model() -> None:
    """Each is a mean of 15 periodograms and scatters by a third: a factor of two is four deviations and more."""
    residual = lfilter([1.0], [1.0, -0.9], np.random.default_rng(4).standard_normal(20_000))
    noise = NoiseModel(np.array([1.0, -0.9]), 1.0, 1.0 / 0.19, 0.1)
    axis = draw_spectrum(noise, residual, 0.1)
    (omega, measured), (_, model) = (line.get_data() for line in axis.lines)
    assert omega.max() <= math.pi / 0.1
    assert np.median(np.abs(np.log(measured / noise.spectrum(omega)))) < math.log(2.0)
    assert model[0] > 50.0 * model[-1]
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["residual", "model of order 1"]
    assert not draw_spectrum(None, residual[:20], 0.1).lines


def test_excitation_is_drawn_over_time() -> None:
    found = excitation(np.random.default_rng(0).standard_normal((4000, 2)))
    top, bottom = draw_excitation(found, 0.05)
    np.testing.assert_allclose(top.lines[0].get_xydata(), np.column_stack([found.samples * 0.05, found.smallest]))
    np.testing.assert_allclose(bottom.lines[0].get_ydata(), found.condition)
    assert (top.get_yscale(), bottom.get_yscale()) == ("log", "log")


def test_a_signal_that_stands_still_gets_an_axis_worth_reading() -> None:
    """A model that differs from it by rounding does not make ticks that all read the same."""
    low, high = style.output_limits(np.full(10, 3.0), np.full(10, 3.0 + 1e-15))
    assert low < 2.0 < 4.0 < high
    assert style.output_limits(np.zeros(10), np.zeros(10)) == pytest.approx((-0.55, 0.55))


def test_every_figure_draws_into_the_axes_it_is_given(uncertain) -> None:
    result, u, y, dt = record(uncertain)
    figure = Figure()
    axes = figure.subplots(4, 4).ravel()
    found = correlations(y - result.simulation.output, u, 50)
    calls = [
        (3, lambda given: draw_fit(result, u, y, dt, axes=given)),
        (4, lambda given: draw_transients(result, dt, axes=given)),
        (2, lambda given: draw_bode(result, dt, axes=given)),
        (2, lambda given: draw_correlations(found, dt, axes=given)),
        (2, lambda given: draw_excitation(None, dt, axes=given)),
        (1, lambda given: [draw_poles_and_zeros(result, ax=given[0])]),
        (1, lambda given: [draw_spectrum(result.noise, y - result.simulation.output, dt, ax=given[0])]),
    ]
    begin = 0
    for count, call in calls:
        given = axes[begin : begin + count]
        assert [id(axis) for axis in call(given)] == [id(axis) for axis in given]
        begin += count
    with pytest.raises(ValueError, match="3 axes, got 2"):
        draw_fit(result, u, y, dt, axes=axes[:2])


def test_bad_results_are_drawn_too(bad, tmp_path) -> None:
    _, case = bad
    result, u, y, dt = record(case)
    draw_poles_and_zeros(result).figure.savefig(tmp_path / "poles.png")
    for axes in (draw_bode(result, dt), draw_correlations(None, dt), draw_excitation(None, dt)):
        axes[0].figure.savefig(tmp_path / "any.png")
    assert {path.name for path in save_figures(tmp_path, result, u, y, dt)} >= {"fit.png"}


def test_colours_differ_in_grey() -> None:
    """Curves that share an axis differ in lightness by a tenth at least; what lies below is the wider one."""

    def lightness(colour: str) -> float:
        red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    for one, other in ((style.MEASURED, style.MODEL), (style.MODEL, style.TRUTH), (style.MODEL, style.RESIDUAL)):
        assert abs(lightness(one) - lightness(other)) > 0.02


def test_the_true_plant_of_a_simulated_record_is_drawn_beside_the_model(plain) -> None:
    truth = rp.TransferFunction([3.0, 6.0], [1.0, 1.6, 4.0])
    for axes in (draw_bode(plain.result, 0.05, truth=truth), [draw_step(plain.result, truth=truth)]):
        assert "true" in {line.get_label() for line in axes[0].get_lines()}
    omega, magnitude = curves(draw_bode(plain.result, 0.05, truth=truth)[0])["true"].T
    np.testing.assert_allclose(magnitude, 20 * np.log10(np.abs(truth.response(omega))))
    poles = curves(draw_poles_and_zeros(plain.result, truth=truth))["true poles"]
    np.testing.assert_array_equal(poles, np.column_stack([truth.poles.real, truth.poles.imag]))
    assert "true" not in {line.get_label() for line in draw_step(plain.result).get_lines()}


@every(
    ("draw", "words"),
    [
        (lambda r, y, dt: draw_fit(r, y, y, dt, output_label=1.0), "output_label must be a str"),
        (lambda r, y, dt: draw_transients(r, dt, input_label=None), "input_label must be a str"),
        (lambda r, y, dt: draw_bode(r, dt, truth=r), "truth must be a TransferFunction or None"),
        (lambda r, y, dt: draw_step(r.model), "result must be a Result"),
        (lambda r, y, dt: draw_step(r, truth=[1.0]), "truth must be a TransferFunction or None"),
        (lambda r, y, dt: draw_poles_and_zeros(None), "result must be a Result"),
        (lambda r, y, dt: draw_poles_and_zeros(r, truth="G"), "truth must be a TransferFunction or None"),
        (lambda r, y, dt: draw_excitation(y, dt), "found must be an Excitation or None"),
        (lambda r, y, dt: draw_excitation(None, dt, clock=y), "clock must be a Clock or None"),
        (lambda r, y, dt: draw_spectrum("white", y, dt), "noise must be a NoiseModel or None"),
        (lambda r, y, dt: draw_spectrum(None, None, dt), "residual must hold real numbers"),
        (lambda r, y, dt: draw_spectrum(None, y, "1"), "dt must be a number"),
        (lambda r, y, dt: draw_outputs(r, y, dt), "results must be a dict of Result"),
        (lambda r, y, dt: draw_outputs({}, y, dt), "results must be a dict of Result"),
        (lambda r, y, dt: draw_outputs({"a": r}, y[1:], dt), "y must be the record of the results, 4000 samples long"),
        (lambda r, y, dt: draw_overlay({"a": y}, dt), r"results\['a'\] must be a Result"),
        (lambda r, y, dt: draw_overlay({"a": r}, dt, reference="b"), "reference must be one of 'a', got 'b'"),
        (lambda r, y, dt: draw_responses({"a": r}, None), "dt must be a number"),
        (lambda r, y, dt: draw_responses([r], dt), "results must be a dict of Result"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_named_in_a_line(plain, draw, words) -> None:
    result, _, y, dt = record(plain)
    with pytest.raises(rp.ReplantError, match=f"^{words}") as caught:
        draw(result, y, dt)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_estimates_of_other_coefficients_are_not_drawn_over_each_other(plain) -> None:
    """The same place in two structures is another coefficient: a0 of one pole was drawn over a1 of two."""
    result, u, y, dt = record(plain)
    other = rp.run(u, y, dt, poles=1)
    with pytest.raises(InvalidArgumentError, match="the same coefficients: 'one' has a0, b0, 'two' a1, a0"):
        draw_overlay({"one": other, "two": result}, dt)
