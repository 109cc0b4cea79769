"""`fit` of several inputs: each transfer function has poles and a dead time of its own."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import replant as rp
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import chi2_quantile
from support.cases import every
from support.rows import ASKED, DT, FAST, SLOW, TRUE, noisy, row_of, toggling


@cache
def without_noise(correlation: float = 0.0) -> Any:
    u = toggling(0, correlation=correlation, samples=1000)
    return rp.fit(u, row_of(u, FAST, SLOW), DT, **ASKED)


@cache
def with_noise(seed: int, samples: int = 4000, pole: float = 0.0, correlation: float = 0.0) -> Any:
    u = toggling(seed, samples=samples, correlation=correlation)
    y = noisy(seed, row_of(u, FAST, SLOW), pole, 20.0 if pole else 10.0)  # a slow pole is told late in slow noise
    return rp.fit(u, y, DT, **ASKED)


@every("correlation", [0.0, 0.9])
def test_a_row_without_noise_is_found_exactly(correlation: float) -> None:
    found = without_noise(correlation)
    assert found.parameters == pytest.approx(TRUE, rel=1e-6)
    assert found.names == ("a1.u1", "a0.u1", "b0.u1", "a0.u2", "b0.u2")
    assert found.transfer_functions[1].delay == 0.3
    assert found.fit > 99.99


def test_three_inputs_with_zeros_are_told_apart() -> None:
    plant = FAST, SLOW, rp.TransferFunction([1.0, 4.0], [1.0, 1.0, 4.0])
    u = toggling(1, inputs=3, samples=1000)
    found = rp.fit(u, row_of(u, *plant), DT, poles=(2, 1, 2), zeros=(0, 0, 1), delay=(0.0, 0.3, 0.0))
    for g, true in zip(found.transfer_functions, plant, strict=True):
        assert [*g.num, *g.den] == pytest.approx([*true.num, *true.den], rel=1e-5)


@pytest.mark.slow
@every(
    "pole, correlation, runs",
    [(0.0, 0.0, 3), (0.0, 0.9, 6), (0.9, 0.0, 6), (0.9, 0.9, 6)],
    quick=1,
)
def test_the_joint_covariance_is_that_of_the_errors(pole: float, correlation: float, runs: int) -> None:
    """The sum of e' C^-1 e over runs is chi-square; the noise model is estimated too, hence a third on top."""
    total = 0.0
    for seed in range(runs):
        found = with_noise(seed, pole=pole, correlation=correlation)
        error = found.parameters - TRUE
        total += float(error @ np.linalg.solve(found.covariance, error))
        assert found.verdict.status == "trusted", found.verdict
    least, most = chi2.ppf([1e-4, 0.9999], runs * TRUE.size)
    assert least < total < 1.33 * most


@pytest.mark.slow
def test_a_slow_pole_in_slow_noise_is_not_known() -> None:
    """The first input makes most of the output, and white parts of the noise hide no coefficient of it."""
    slower = rp.TransferFunction([0.2], [1.0, 0.02], delay=0.3)
    verdict = rp.fit(toggling(1), noisy(1, row_of(toggling(1), FAST, slower), 0.9), DT, **ASKED).verdict
    assert verdict.status == "converging"
    assert [reason[:34] for reason in verdict.reasons] == ["input u2: a coefficient is known t"]


@pytest.mark.slow
def test_lost_outputs_inputs_and_a_gap_cost_what_they_told() -> None:
    u = toggling(2)
    y = noisy(2, row_of(u, FAST, SLOW))
    t = DT * np.arange(y.size)
    y[np.random.default_rng(3).choice(y.size, 400, replace=False)] = np.nan
    kept = np.r_[0:1500, 2000:4000]
    found = rp.fit(u[kept], y[kept], DT, t=t[kept], **ASKED)
    told = np.isfinite(y)
    told[[*range(6), *range(2000, 2006)]] = False  # they answer to inputs before, by the dead time
    assert found.samples == told[kept].sum()
    error = found.parameters - TRUE
    assert float(error @ np.linalg.solve(found.covariance, error)) < chi2_quantile(0.9999, TRUE.size)
    assert np.isfinite(found.output[told[kept]]).all()
    assert np.isnan(found.output[[*range(6), *range(1500, 1506)]]).all()


@pytest.mark.slow
def test_outliers_and_a_stuck_sensor_are_left_out_as_of_one_input() -> None:
    u = toggling(6, samples=2000)
    y = noisy(6, row_of(u, FAST, SLOW))
    clean = rp.fit(u, y, DT, **ASKED)
    spikes = np.random.default_rng(7).choice(1400, 20, replace=False) + 10
    y[spikes] += 40.0
    y[1500:1580] = y[1499]
    y[[700, 701]] = np.nan
    found = rp.fit(u, y, DT, **ASKED)
    assert set(spikes) - {700, 701} <= set(found.outliers.tolist())
    assert set(range(1501, 1580)) <= set(found.stuck.tolist())
    assert found.missing.tolist() == [700, 701]
    assert found.rejected == {
        "not finite": 2,
        "too large": 0,
        "outlier": found.outliers.size,
        "stuck": found.stuck.size,
    }
    assert found.outliers.size < 30
    error = found.parameters - TRUE
    assert float(error @ np.linalg.solve(found.covariance, error)) < chi2_quantile(0.9999, TRUE.size)
    assert found.samples == clean.samples - found.outliers.size - found.stuck.size - 2
    assert any("outputs were left out: the sensor was stuck" in reason for reason in found.verdict.reasons)
    assert clean.rejected == {"not finite": 0, "too large": 0, "outlier": 0, "stuck": 0}


def test_the_fit_leaves_out_what_answers_to_inputs_before_the_record() -> None:
    late = rp.TransferFunction([4.0], [1.0, 2.0], delay=1.0)
    u = toggling(8, samples=620)
    y = row_of(u, late, SLOW) + 3.0
    found = rp.fit(u[20:], y[20:], DT, poles=(1, 1), delay=(1.0, 0.3))
    assert found.samples == 580
    assert found.fit > 99.99
    assert found.model.simulated_fit == found.fit
    assert found.model.validate(u[20:], y[20:]).fit == pytest.approx(found.fit)


def test_the_simulation_is_the_sum_of_the_branches() -> None:
    u, found = toggling(0), with_noise(0)
    model = found.model
    rest = model.output_level + sum(
        g.dc_gain * (first - level)
        for g, first, level in zip(model.transfer_functions, u[0], model.input_levels, strict=True)
    )
    assert model.simulate(u) == pytest.approx(rest + row_of(u - u[0], *found.transfer_functions))
    with pytest.raises(rp.InvalidArgumentError, match="u must have a column for each of 2 inputs"):
        model.simulate(toggling(0, inputs=3))


def test_the_text_names_each_input_and_the_verdict() -> None:
    text = repr(without_noise())
    assert "u1: 20 / (s^2 + 11 s + 10)" in text
    assert "u2: 0.2 / (s + 0.1) exp(-0.3 s)" in text


@pytest.mark.slow
def test_each_of_several_logs_has_an_offset_and_initial_states_of_its_own() -> None:
    logs = []
    for seed in range(4):
        u = toggling(seed, samples=500)
        y = row_of(u, FAST, SLOW) + 0.05 * np.random.default_rng(seed).standard_normal(500) + 10.0 * seed
        u, y = u[200:], y[200:]  # it begins in motion
        logs.append(rp.Log(u[:, 0].copy(), y, DT, others={"u2": u[:, 1].copy()}, more_inputs=("u2",)))
    found = rp.fit(logs, **ASKED)
    error = found.parameters - TRUE
    assert error @ np.linalg.solve(found.covariance, error) < chi2_quantile(0.9999, TRUE.size)
    assert found.verdict.status == "trusted"
    one = rp.fit(logs[0], **ASKED)
    assert (np.diag(found.covariance) < 0.5 * np.diag(one.covariance)).all()


class TestVerdict:
    """Each reason is given where it is the cause, and not beside it."""

    def status(self, u: FloatArray, y: FloatArray, **asked: Any) -> tuple[str, str]:
        found = rp.fit(u, y, DT, **(asked or ASKED)).verdict
        return found.status, " ".join(found.reasons)

    @pytest.mark.slow
    def test_an_input_that_rests(self) -> None:
        u = toggling(0)
        u[:, 1] = 3.0
        status, reasons = self.status(u, noisy(0, row_of(u[:, :1], FAST)))
        assert status == "not excited"
        assert "input u2 does not move" in reasons
        u[:, 1] = toggling(0)[:, 1]
        u[800:, 1] = u[800, 1]  # four fifths of the record
        assert "does not move" not in self.status(u, noisy(0, row_of(u, FAST, SLOW)))[1]

    @pytest.mark.slow
    def test_an_output_that_is_an_input(self) -> None:
        u = toggling(0)
        status, reasons = self.status(u, u[:, 1].copy())
        assert status == "inconsistent"
        assert reasons.startswith("the output is a copy of the input u2")

    @pytest.mark.slow
    def test_inputs_that_move_together(self) -> None:
        u = toggling(1, correlation=0.9999, samples=2000)
        status, reasons = self.status(u, noisy(1, row_of(u, FAST, FAST)), poles=(2, 2))
        assert status == "inconsistent"
        assert "any of inputs u1 and u2 could be left out, but not all of them: they move together" in reasons
        status, reasons = self.status(u, row_of(u, FAST, FAST), poles=(2, 2))
        assert status == "trusted"  # without noise they are told apart
        u = toggling(1, correlation=0.9, samples=2000)
        assert self.status(u, noisy(1, row_of(u, FAST, FAST)), poles=(2, 2))[0] == "trusted"

    @pytest.mark.slow
    @pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1)), 2, 3])
    def test_inputs_that_are_one_signal(self, seed: int) -> None:
        u = toggling(seed, samples=2000)[:, :1] @ np.array([[1.0, -0.3]])
        status, reasons = self.status(u, noisy(seed, row_of(u[:, :1], FAST)), poles=(2, 1), delay=(0.0, 0.3))
        assert status == "not excited"
        assert "inputs u1 and u2 move together as one signal" in reasons
        apart = u + np.outer(np.arange(2000) == 1000, [0.0, 1.0])  # a single sample makes them two
        assert "as one signal" not in self.status(apart, noisy(seed, row_of(u[:, :1], FAST)), poles=(2, 1))[1]

    @pytest.mark.slow
    def test_an_input_that_explains_nothing(self) -> None:
        u = toggling(2)
        status, reasons = self.status(u, noisy(2, row_of(u[:, :1], FAST)), poles=(2, 1))
        assert status != "trusted"
        assert "input u2" in reasons
        assert "input u1" not in reasons

    @pytest.mark.slow
    def test_a_pole_too_few(self) -> None:
        plant = rp.TransferFunction([4.0], [1.0, 0.8, 4.0]), SLOW
        u = toggling(3, samples=2000)
        y = noisy(3, row_of(u, *plant))
        status, reasons = self.status(u, y, poles=(1, 1), delay=(0.0, 0.3))
        assert status == "inconsistent"
        assert "the inputs could explain a further" in reasons
        assert self.status(u, y, poles=(2, 1), delay=(0.0, 0.3))[0] == "trusted"

    @pytest.mark.slow
    def test_what_a_structure_leaves_is_no_answer_of_smooth_inputs(self) -> None:
        """An input that says what it will be next explains a residual that it will explain next."""
        smooth = np.convolve(toggling(6, samples=2100)[:, 1], np.hanning(101) / 50.0, "valid")[:2000]
        u = np.column_stack([toggling(5, samples=2000)[:, 0], smooth])
        plant = FAST, rp.TransferFunction([0.4, 1.0], [1.0, 0.3, 1.0])
        status, reasons = self.status(u, noisy(5, row_of(u, *plant)), poles=(2, 1))
        assert status == "inconsistent"
        assert "answers to disturbances" not in reasons

    def test_a_controller_that_makes_an_input(self) -> None:
        r, noise = toggling(4), np.random.default_rng(4).standard_normal(4000)
        u, y, state, error = r.copy(), np.zeros(4000), 0.0, 0.0
        a = np.exp(-DT)
        for k in range(1, 4000):
            state = a * state + (1.0 - a) * u[k - 1, 0]
            error = 0.95 * error + 0.1 * noise[k]
            y[k] = state + error
            u[k, 0] = r[k, 0] - 3.0 * y[k]
        y += rp.TransferFunction([1.0], [1.0, 3.0]).simulate(u[:, 1].copy(), DT)
        status, reasons = self.status(u, y, poles=(1, 1))
        assert status == "inconsistent"
        assert "input u1 answers to disturbances" in reasons
        assert "input u2 answers" not in reasons


U, Y = toggling(0, samples=400), np.arange(400.0)
FORMER = np.arange(400) < 200


@every(
    "u, y, asked, words",
    [
        (U, Y, {"poles": 1}, r"there are 2 inputs: give the number of poles of each, poles=\(1, 1\)"),
        (U, Y, {"poles": (1, 1, 1)}, "poles has 3 entries and u 2 inputs"),
        (U, Y, {"poles": (1, 1), "delay": (0.1,)}, "delay has 1 entry and u 2 inputs"),
        (U, Y, {"poles": (1, 1), "zeros": (0, 1)}, "zeros must be fewer than poles"),
        (U, Y, {"poles": (6, 6)}, "at most 10 in all, got 12"),
        (U, Y, {"poles": (1, 1), "delay": (0.0, 99.0)}, "no shorter than the record"),
        (U, Y, {"poles": (1, 1), "reference": Y[:9]}, "reference must have one value for each of 400 samples"),
        (U, Y, {"poles": (1, 1), "method": "least_squares"}, "several inputs take no method yet"),
        (U[:5], Y[:5], {"poles": (1, 1)}, "fewer than the"),
        (U, Y[:9], {"poles": (1, 1)}, "u has 400 rows and y 9 samples"),
        (U[:, 0], Y, {"poles": (1, 1)}, "a column for each input"),
        (U * np.nan, Y, {"poles": (1, 1)}, "input u1 has no number that can be used"),
        (U * [1.0, np.nan], Y, {"poles": (1, 1)}, "input u2 has no number that can be used"),
        (np.where(FORMER, U.T, np.nan).T, np.where(FORMER, np.nan, Y), {"poles": (1, 1)}, "no row of u and y has all"),
        (U, Y, {"poles": (1, 1), "reference": Y * np.nan}, "reference has no number that can be used"),
        (U, Y, {"poles": (1, 1), "reference": np.column_stack([Y, Y * np.nan])}, "reference 2 has no number"),
        (U, np.column_stack([Y, Y * np.nan]), {"poles": (1, 1)}, "output y2 has no number that can be used"),
        (U[:, :1], Y, {"poles": 1}, r"there is 1 input: give the number of poles of each, poles=\(1,\)"),
        (U[:10], Y[:10], {"poles": (1, 1), "delay": (0.0, 5 * DT)}, "has 5 usable samples after the dead time"),
        (U[:8], Y[:8], {"poles": (1, 1), "delay": (0.0, 3 * DT)}, "fewer than the 8 that 7 unknowns need"),
    ],
)
def test_what_does_not_match_is_named_in_a_line(u: Any, y: Any, asked: dict[str, Any], words: str) -> None:
    with pytest.raises(rp.ReplantError, match=words) as caught:
        rp.fit(u, y, DT, **asked)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@every("seed", [4, 0, 2, 3, 5, 1], quick=1)
def test_an_output_that_has_nothing_to_do_with_the_inputs_is_not_trusted(seed: int) -> None:
    """A slow pole follows a random walk, and the standard deviations of what follows from the inputs are its size."""
    walk = np.cumsum(np.random.default_rng(seed).standard_normal(3000))
    verdict = rp.fit(toggling(seed, samples=3000), walk, DT, poles=(1, 1)).verdict
    assert verdict.status != "trusted"
    if seed == 1:  # of the others something else is said
        assert any("uncertainty of its transfer function" in reason for reason in verdict.reasons)


@pytest.mark.slow
@every("seed", [119, 122, 127, 140], quick=1)
def test_a_model_beside_which_others_are_as_likely_is_not_trusted(seed: int) -> None:
    """Standard deviations are of one minimum: these are 20 and more of them away from the truth, which is as likely."""
    plant = rp.TransferFunction([0.4], [1.0, 2.1, 0.2]), rp.TransferFunction([10.0], [1.0, 5.0], delay=0.3)
    u = toggling(seed, samples=2000, correlation=0.9)
    found = rp.fit(u, noisy(seed, row_of(u, *plant), 0.9), DT, **ASKED)
    assert found.verdict.status != "trusted"
    assert any("another model is as likely" in reason for reason in found.verdict.reasons)


@pytest.mark.slow
@every("size", [1e-80, 1e80, 1e140], quick=1)
def test_the_unit_of_the_signals_changes_no_estimate(size: float) -> None:
    u = toggling(0, samples=500)
    y = noisy(0, row_of(u, FAST, SLOW))
    usual = with_noise(0, 500).parameters
    assert rp.fit(u * size, y * size, DT, **ASKED).parameters == pytest.approx(usual, rel=1e-6)


@pytest.mark.slow
def test_a_zero_that_may_cancel_a_pole_of_an_input_is_named() -> None:
    u = toggling(0)
    found = rp.fit(u, noisy(0, row_of(u, FAST, SLOW)), DT, poles=(2, 2), zeros=(0, 1), delay=(0.0, 0.3))
    assert any("input u2: a zero may cancel the pole" in reason for reason in found.verdict.reasons)


def test_what_a_decimated_record_sees_ahead_is_no_controller() -> None:
    u = toggling(1)
    y = row_of(u, FAST, SLOW)
    log = rp.Log(u[:, 0], y + 0.01 * np.random.default_rng(1).standard_normal(len(y)), DT, others={"u2": u[:, 1]},
                 more_inputs=("u2",))  # fmt: skip
    found = rp.fit(rp.decimate(log, 4), poles=(2, 1), delay=(0.0, 0.3))
    assert not any("a controller makes it" in reason for reason in found.verdict.reasons)


@pytest.mark.slow
def test_a_table_gives_several_inputs() -> None:
    pandas = pytest.importorskip("pandas")
    u = toggling(2)
    y = noisy(2, row_of(u, FAST, SLOW))
    frame = pandas.DataFrame({"a": u[:, 0], "b": u[:, 1], "y": y})
    found = rp.fit(frame, dt=DT, input=["a", "b"], output="y", **ASKED)
    assert (found.parameters == with_noise(2).parameters).all()
    assert found.model.input_names == ("a", "b")
    for wrong, words in ((["a", "a"], "each column once"), (["a", "c"], "input must name a column, got 'c'")):
        with pytest.raises(rp.ReplantError, match=words):
            rp.fit(frame, dt=DT, input=wrong, output="y", **ASKED)


def test_inputs_that_move_together_and_are_both_needed() -> None:
    """Their difference is small beside the noise, and tells the second gain to a fifth."""
    u = toggling(3, correlation=0.995, samples=2000)
    found = rp.fit(u, noisy(3, row_of(u, FAST, FAST)), DT, poles=(2, 2))
    assert any("inputs u1 and u2" in reason and "together" in reason for reason in found.verdict.reasons)


@pytest.mark.slow
@every("power", [0, 10, 20], quick=1)
def test_one_load_is_no_more_than_one_whatever_the_unit(power: int) -> None:
    """A model that it has led astray sees others, which are needless once it is known."""
    rng = np.random.default_rng(0)
    plant = rp.TransferFunction([2.0], [1.0, 0.5]), rp.TransferFunction([3.0], [1.0, 1.5, 2.0])
    u = np.column_stack([rng.choice([-1.0, 1.0], 188).repeat(8)[:1500], rng.uniform(-1.0, 1.0, 38).repeat(40)[:1500]])
    y = np.sum([g.simulate(each.copy(), 0.1) for g, each in zip(plant, u.T, strict=True)], axis=0)
    y += 0.3 * y.std() * rng.standard_normal(1500) + 5.0 * (np.arange(1500) >= 700)
    found = rp.fit(u, y * 2.0**power, 0.1, poles=(1, 2))
    assert found.loads.tolist() == pytest.approx([700], abs=5)
    assert found.verdict.status == "trusted"


@every("seed", [1, 4], quick=1)
def test_what_the_samples_do_not_determine_is_unknown_and_not_known_exactly(seed: int) -> None:
    """With too long a dead time, and no noise model, two poles of the second input end beyond any sampling."""
    u = toggling(seed, samples=1000)
    y = row_of(u, rp.TransferFunction([-1.0], [1.0, 0.5]), rp.TransferFunction([8.0], [1.0, 5.0]))
    y += 0.03 * np.random.default_rng(seed).standard_normal(1000)
    found = rp.fit(u, y, DT, poles=(1, 2), delay=(0.0, 0.3))
    known, unknown = found.uncertainty
    assert (known.std > 0.0).all()
    assert (known.std < 0.5).all()
    assert np.isinf(unknown.std).all()
    assert (np.diag(found.covariance) > 0.0).all()


@every("inputs", [1, 2])
@every("scale", [1e-140, 1e-160, 1e-300])
def test_signals_whose_squares_leave_float64_are_refused(inputs: int, scale: float) -> None:
    u = toggling(1, samples=400)[:, :inputs]
    y = noisy(1, row_of(u, *(FAST, SLOW)[:inputs]))
    poles: Any = (2, 1)[:inputs] if inputs > 1 else 2
    if scale >= 1e-150:
        assert rp.fit(u.squeeze(), scale * y, DT, poles=poles).parameters[:2] == pytest.approx(
            rp.fit(u.squeeze(), y, DT, poles=poles).parameters[:2], rel=1e-6
        )
        return
    with pytest.raises(rp.InvalidArgumentError, match=r"output.* moves by .* only, whose square leaves float64"):
        rp.fit(u.squeeze(), scale * y, DT, poles=poles)
