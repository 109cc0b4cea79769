"""From figures to a word: the gravest finding makes it, and every status has its reason."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.numerics.levels import LARGEST_PART, NEGLIGIBLE
from replant.numerics.score_test import Explained
from replant.verdict import Assessment, assess_record
from replant.verdict.evidence import Evidence
from replant.verdict.reasons import judge
from replant.verdict.verdict import STATUSES, Finding, conclude, percent
from support.builders import binary
from support.cases import every

DT, SAMPLES = 0.05, 4000
STRUCTURE, TRUE = rp.Structure(2), np.array([4.0, 3.0, 2.0])
U = binary(1, SAMPLES, 8)
Y = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]).simulate(U, DT)
Y = Y + 0.1 * Y.std() * np.random.default_rng(0).standard_normal(SAMPLES)
STD = 0.005 * TRUE


def evidence(**changes: Any) -> Evidence:
    """A right estimate, known to half a percent, that has not seen the last quarter."""
    record = Record(changes.pop("u", U), changes.pop("y", Y), changes.pop("intervals", np.array([DT])))
    sound: dict[str, Any] = {
        "structure": STRUCTURE, "dt": DT, "record": record, "estimate": TRUE, "covariance": np.diag(STD**2),
        "earlier": TRUE, "unseen": 1000, "learned": 3000,
    }  # fmt: skip
    return Evidence(**{**sound, **changes})


def test_a_right_estimate_is_trusted_and_its_figures_are_there() -> None:
    verdict = judge(evidence())
    assert verdict.status == "trusted"
    assert len(verdict.reasons) == 1
    assert (verdict.samples, verdict.held_out) == (SAMPLES, 1000)
    figures = [getattr(verdict, field.name) for field in dataclasses.fields(Assessment)[2:]]
    assert np.isfinite(figures).all()
    assert verdict.fit == pytest.approx(90.0, abs=1.0)
    assert verdict.uncertainty == pytest.approx(0.005 * 3.0 / 3.0, rel=0.3)


@pytest.mark.parametrize("std", [1e-4, 0.1])
def test_a_model_that_runs_away_in_open_loop_is_refused_however_unsure_its_pole_is(std: float) -> None:
    """Simulated on, it leaves every output behind: the record is long enough for e^2."""
    pole = 2.0 / (DT * SAMPLES)
    verdict = judge(
        evidence(structure=rp.Structure(1), estimate=np.array([-pole, 1.0]), earlier=np.array([-pole, 1.0]),
                 covariance=np.diag([std**2, 1e-6]))
    )  # fmt: skip
    assert verdict.status == "inconsistent"
    assert any("the model diverges" in reason for reason in verdict.reasons)


def test_a_long_record_that_was_solved_again_just_now_is_judged_in_sample() -> None:
    verdict = judge(evidence(unseen=20))
    assert (verdict.status, verdict.held_out) == ("trusted", 0)
    assert "in sample" in verdict.reasons[0]
    assert judge(evidence(unseen=20, y=np.roll(Y, 20))).status == "inconsistent"


def test_a_coefficient_that_is_known_badly_is_said_where_the_model_is_known_well() -> None:
    """Errors of 16 % that go together leave gain and slow mode alone; by themselves they are errors of the output."""
    std = 0.16 * TRUE
    together = std[:, None] * (0.99999 + 0.00001 * np.eye(3)) * std
    verdict, apart = judge(evidence(covariance=together)), judge(evidence(covariance=np.diag(std**2)))
    assert verdict.uncertainty == pytest.approx(apart.uncertainty) == pytest.approx(0.16)
    assert (verdict.status, apart.status) == ("trusted", "converging")
    assert verdict.reasons[1].startswith("a coefficient has a standard deviation of 16 %, but")
    assert "rely on G(s) where the input excites it" in verdict.reasons[1]


@pytest.mark.parametrize("faster", [1.0, 1e8])  # whatever the unit of time is
def test_the_distance_to_a_record_is_measured_by_the_scatter_of_the_estimate_made_from_it(faster: float) -> None:
    """It may be the noise model's: an estimate of the output error scatters more under coloured noise."""
    units = np.array([faster, faster**2, faster**2])
    off = TRUE * [1.4, 1.0, 1.0] * units
    made_from = {"estimate": off, "earlier": off, "unseen": 0, "in_sample": True, "dt": DT / faster}

    def reasons(std: float, *, finished: bool) -> str:
        known, intervals = np.diag((std * TRUE * units) ** 2), np.array([DT / faster])
        return " ".join(judge(evidence(covariance=known, finished=finished, intervals=intervals, **made_from)).reasons)

    assert "the same record gives another model" not in reasons(0.2, finished=True)
    assert "the same record gives another model" in reasons(0.005, finished=True)
    assert "has not converged" not in reasons(0.005, finished=True)
    assert "has not converged" in reasons(0.005, finished=False)


@every(
    ("changes", "status", "words"),
    [
        ({"refused": True}, "diverged", "float64"),
        ({"u": np.ones(SAMPLES)}, "not excited", "is constant"),
        ({"u": np.where(np.arange(SAMPLES) < 400, U, 1.0)}, "not excited", "hardly moves"),
        ({"largest_power": 1e5}, "not excited", "variance"),
        ({"usual_interval": 0.5}, "inconsistent", "time stamps"),
        ({"y": U, "u": Y}, "inconsistent", "swapped"),
        ({"y": np.ones(SAMPLES)}, "inconsistent", "is constant"),
        ({"y": Y - np.mean(Y) + 5.0 * binary(7, SAMPLES, 3)}, "inconsistent", "almost nothing"),
        ({"y": np.roll(Y, 20)}, "inconsistent", "could explain another"),
        ({"y": Y + np.where(np.arange(SAMPLES) > 3000, 0.3, 0.0) * np.sin(2.1 * np.arange(SAMPLES))}, "inconsistent",
         "has grown"),
        ({"y": np.where(np.arange(SAMPLES) > 3950, 0.5, Y)}, "inconsistent", "constant to the bit"),
        ({"y": Y + np.where(np.arange(SAMPLES) > 3960, 1.0, 0.0)}, "inconsistent", "any earlier stretch"),
        ({"estimate": np.array([-9.0, 3.0, 2.0]), "earlier": np.array([-9.0, 3.0, 2.0])}, "inconsistent", "diverges"),
        ({"u": U[:900], "y": Y[:900], "unseen": 20}, "converging", "20 samples"),
        ({"u": U[:900], "y": Y[:900], "unseen": 0}, "converging", "has used every sample"),
        ({"covariance": np.diag((0.5 * TRUE) ** 2)}, "converging", "has a standard deviation of"),
        ({"earlier": TRUE * [1.5, 1.0, 1.0]}, "converging", "has moved"),
        ({"earlier": TRUE * 0.8, "estimate": TRUE * 0.8, "adapts": False}, "inconsistent", "has changed since"),
        ({"earlier": TRUE * 0.9, "estimate": TRUE * 0.9, "instruments": False}, "inconsistent", "noise biases"),
        ({"y": np.roll(Y, 20), "instruments": False}, "inconsistent", "noise, which biases"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_each_finding_has_its_word_and_its_reason(changes: dict[str, Any], status: str, words: str) -> None:
    verdict = judge(evidence(**changes))
    assert verdict.status == status, verdict.reasons
    assert any(words in reason for reason in verdict.reasons), verdict.reasons


@pytest.mark.parametrize(
    ("samples", "noise", "tells"), [(SAMPLES, 0.01, True), (300, 0.5, False), (SAMPLES, 3.0, False)]
)
def test_after_an_alarm_nothing_is_trusted_before_the_gain_can_show(samples: int, noise: float, tells: bool) -> None:
    """What raised it may have been a change that the fitted offset hides: one of a tenth must be able to show."""
    u = U[:samples]
    y = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]).simulate(u, DT)
    y = y + noise * y.std() * np.random.default_rng(0).standard_normal(samples)
    found = {"u": u, "y": y, "estimate": TRUE, "earlier": TRUE, "unseen": samples // 2}
    found["covariance"] = np.diag((1e-3 * np.abs(TRUE)) ** 2)
    said = " ".join(judge(evidence(**found, after_alarm=True)).reasons)
    assert ("as usual again" in said) == (not tells), said
    assert "as usual again" not in " ".join(judge(evidence(**found)).reasons)


@pytest.mark.parametrize(("size", "status"), [(0.005, "trusted"), (0.5, "converging")])
def test_slow_noise_is_named_where_it_is_why_the_estimate_is_known_no_better(size: float, status: str) -> None:
    covariance = np.diag((size * TRUE) ** 2)
    for slowness, named in ((1.0, False), (2.0, False), (10.0, True)):
        verdict = judge(evidence(covariance=covariance, slowness=slowness))
        assert verdict.status == status
        assert ("the output drifts" in verdict.reasons[0]) == named
    rounding = judge(evidence(covariance=1e-20 * covariance, slowness=10.0))
    assert "the output drifts" not in rounding.reasons[0]


def test_a_small_part_that_is_left_is_a_caveat() -> None:
    """Nearly free of noise, the plant bends a little: the square of its output is added, which no G(s) makes."""
    clean = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]).simulate(U, DT)
    missing = clean**2
    clean = clean + 1e-3 * clean.std() * np.random.default_rng(1).standard_normal(SAMPLES)
    for part, status in ((NEGLIGIBLE / 100, ""), (np.sqrt(NEGLIGIBLE * LARGEST_PART), "trusted"), (0.05, "wrong")):
        y = clean + np.sqrt(part) * clean.std() / missing.std() * missing
        fitted = rp.fit(U, y, DT, STRUCTURE)
        verdict = assess_record(STRUCTURE, fitted.parameters, Record(U, y, np.array([DT])), DT, fitted.covariance)
        assert (verdict.status == "trusted") == (status != "wrong"), verdict
        assert ("acts otherwise at other levels" in " ".join(verdict.reasons)) == (status != "")


def test_the_gravest_finding_comes_first_and_trust_only_without_any() -> None:
    findings = [Finding(status, status) for status in reversed(STATUSES)]
    assert conclude(findings, "good") == ("diverged", STATUSES)
    assert conclude([], "good") == ("trusted", ("good",))
    assert conclude([Finding("trusted", "but")], "good") == ("trusted", ("good", "but"))


def test_percent_has_no_exponent() -> None:
    assert [percent(part) for part in (0.0, 1e-4, 0.0561, 1.0, 63.4)] == ["0 %", "0.01 %", "5.6 %", "100 %", "6300 %"]
    assert [percent(part) for part in (6.6e-32, 1e300)] == ["less than 0.01 %", "more than 10000 %"]


def test_no_reason_has_a_power_of_ten_for_a_span_or_a_part() -> None:
    """The same plant five hundred times as slow, and an input that was far stronger once."""
    slower = TRUE / [500.0, 500.0**2, 500.0**2]
    slow: dict[str, Any] = {
        "dt": 500.0 * DT, "intervals": np.array([500.0 * DT]), "estimate": slower, "earlier": slower,
        "covariance": np.diag((0.005 * slower) ** 2),
    }  # fmt: skip
    assert judge(evidence(**slow)).reasons[0].startswith("simulated from the input alone over the last 25,000 s ")
    rested = judge(evidence(**slow, largest_power=1e30)).reasons[0]
    assert rested.endswith("its variance over the last 25,000 s is less than 0.01 % of its largest so far")


def test_a_part_of_an_output_that_stands_still_is_everything() -> None:
    """Its power is nothing: without a warning that would reach the user's terminal."""
    found = Explained(np.ones(1), power=10.0, std=1.0, statistic=2.0)
    part = found.of_output(np.zeros(2), np.array([-9.0, 9.0]), np.ones(2, bool))
    assert part.is_sure
    assert part.is_large
    assert part.power > 1e300
