"""Numbers and formulas as a person writes them."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

import replant as rp
from replant.plotting.numbers import grouped, mathml, number, uncertain, with_prefix, with_std
from support.cases import every


def written(math: str) -> str:
    """The text of a formula, spaces left out."""
    return "".join(ElementTree.fromstring(math).itertext()).replace(" ", "")


@every(
    ("model", "text"),
    [
        (rp.TransferFunction([3602.0], [1.0, 2.058]), "G(s)=3602s+2.058"),
        (rp.TransferFunction([7.5, -12.5], [1.0, 15.0, 100.0]), "G(s)=7.5s−12.5s2+15s+100"),
        (rp.TransferFunction([1.0, 0.0], [1.0, 0.0, 4.0], 0.25), "G(s)=ss2+4e−0.25s"),
        (rp.TransferFunction([2.0], [1.0, 3.0], 1.0), "G(s)=2s+3e−s"),
        (rp.TransferFunction([0.0], [1.0, 1.0]), "G(s)=0s+1"),
        (rp.TransferFunction([-1.5e-7], [1.0, 2e8]), "G(s)=−1.5×10−7s+2×108"),
    ],
)
def test_formula(model: rp.TransferFunction, text: str) -> None:
    assert written(mathml(model)) == text


def test_long_polynomials_break_into_lines() -> None:
    model = rp.TransferFunction([1.0], np.poly(-np.arange(1.0, 11.0)))
    math = mathml(model)
    assert 3 <= math.count("<mtr>") <= 6
    assert int(re.search(r"--longest:(\d+)", math)[1]) < 60
    ElementTree.fromstring(math)


@every(
    ("value", "std", "text"),
    [
        (1234.5678, 0.0456, "1234.568 ± 0.046"),
        (-0.012326, 0.00067, "−0.01233 ± 0.00067"),
        (5.0, 120.0, "5 ± 120"),
        (1.2345e8, 3.2e5, "(1.2345 ± 0.0032)×10⁸"),
        (2e-9, 1e-10, "(2.00 ± 0.10)×10⁻⁹"),
        (1.0, 0.0, "1"),
        (np.inf, 1.0, "∞"),
        (3.0, np.nan, "3"),
    ],
)
def test_standard_deviation_sets_the_digits(value: float, std: float, text: str) -> None:
    assert uncertain(value, std) == text


@every("value", [0.0, -1e300, 1e-300, 5e-324, 1.7976931348623157e308, 99999.5, 0.00099999])
def test_any_number_can_be_written(value: float) -> None:
    assert number(value)
    assert uncertain(value, abs(value) / 7 or 1.0)


@pytest.mark.parametrize(("value", "text"), [(999.0, "999"), (1000.0, "1 k"), (2.5e9, "2.5 G")])
def test_a_rate_in_three_digits(value: float, text: str) -> None:
    assert with_prefix(value) == text


@every("value", [0.0, -1e300, 1e-300, 5e-324, 1.7976931348623157e308, np.nan, np.inf, 10**400])
def test_a_number_at_the_terminal_is_short_whatever_its_size(value: float) -> None:
    assert len(grouped(value)) < 25
    if isinstance(value, float):
        assert len(with_std(value, abs(value))) < 30
