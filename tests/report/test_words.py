"""Texts about a result, on a page and at a terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import replant as rp
from replant.plotting.numbers import uncertain
from replant.report.compared_page import shortened
from replant.report.contents import lasts
from replant.report.findings import Finding, _sentence, colour_of, without_reasons, words_of
from replant.report.log_as_text import _counted
from replant.report.page_frame import words
from replant.report.results_as_text import _aligned, _blocks, fraction, modes_of, wrapped
from support.cases import every

MOVED = "a coefficient has moved by 2.6 %"


@every(
    ("said", "text"),
    [
        (words_of("trusted").headline, "Trusted"),
        (words_of("biased"), Finding("warn", "Biased", "")),
        (colour_of("trusted"), "green"),
        (colour_of("not excited"), "red"),
        (without_reasons("trusted", excited=False), "trusted, not excited"),
        (without_reasons("trusted", excited=True), "trusted"),
        (
            _sentence("a coefficient has moved over the last 2.45e+03 s"),
            "A coefficient has moved over the last 2450 s.",
        ),
        (wrapped(f"the model fits the output to 83.0 %; {MOVED}", 36), ["the model fits the output to 83.0 %;", MOVED]),
        (wrapped(MOVED, 31), ["a coefficient has moved by", "2.6 %"]),
        (
            fraction(rp.TransferFunction([2.0], [1.0, 4.0, 3.0])),
            ["             2", "G(s) = -------------", "       s^2 + 4 s + 3"],
        ),
        (_counted(1, "gap"), "1 gap"),
        (_counted(4093, "row"), "4,093 rows"),
        (_aligned(["2.1 ± 0.05", "10 ± 1", "3"]), ["2.1 +- 0.05", "10 +- 1   ", "3" + 8 * " "]),
        (_blocks([7, 9, 8, 6, 9, 20, 20], room=72), [[0, 1, 2, 3, 4], [0, 5, 6]]),
        (_blocks([7, 9, 8, 6, 9, 20, 20], room=100), [[0, 1, 2, 3, 4, 5, 6]]),
        (_blocks([7, 9, 8, 6, 9], room=30), [[0, 1, 2], [0, 3, 4]]),
        (words("2 ± 1, <5 %"), "2 ±\xa01, &lt;5\xa0%"),
        (
            shortened("It fails. It does. Why? See."),
            "It fails. It does. <details><summary>More</summary>Why? See.</details>",
        ),
    ],
)
def test_texts_are_as_expected(said: object, text: object) -> None:
    assert said == text


def test_the_duration_of_a_record_comes_from_its_clock() -> None:
    signal = np.zeros(3)
    log = rp.Log(signal, signal, 0.5, np.array([0.0, 0.5, 9.5]), "u", "y", Path("log.csv"))
    assert lasts(log) == "10 s on an irregular clock, usually at 0.5 s"


def test_the_damping_of_a_real_pole_is_exact_even_where_its_place_is_unknown() -> None:
    double = rp.Model(rp.Structure(poles=2), np.array([2.0, 1.0, 1.0]), 0.01, covariance=np.diag([1e-4] * 3))
    assert [row[1:] for row in modes_of(double, uncertain)] == [["1", "1 ± unknown"]] * 2
