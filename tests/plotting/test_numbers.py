"""Numbers and formulas are written as by a person."""

import math
import re
from xml.etree import ElementTree

import numpy as np

import replant as rp
from replant.plotting.numbers import (
    complex_number,
    duration,
    gain_unit,
    grouped,
    interval,
    mapped_label,
    mathml,
    number,
    of_integrator,
    off_by,
    over,
    percent,
    power_of_ten,
    std_alone,
    symbol,
    symbols,
    uncertain,
    with_prefix,
    with_std,
)
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
def test_a_transfer_function_becomes_its_formula(model: rp.TransferFunction, text: str) -> None:
    assert written(mathml(model)) == text


def test_long_polynomials_break_into_lines() -> None:
    model = rp.TransferFunction([1.0], np.poly(-np.arange(1.0, 11.0)))
    math = mathml(model)
    assert 3 <= math.count("<mtr>") <= 6
    assert int(re.search(r"--longest:(\d+)", math)[1]) < 60
    ElementTree.fromstring(math)


@every("value", [0.0, -1e300, 1e-300, 5e-324, 1.7976931348623157e308, 99999.5, 0.00099999])
def test_any_number_can_be_written(value: float) -> None:
    assert number(value)
    assert uncertain(value, abs(value) / 7 or 1.0)


@every("value", [0.0, -1e300, 1e-300, 5e-324, 1.7976931348623157e308, np.nan, np.inf, 10**400])
def test_a_number_at_the_terminal_is_short_whatever_its_size(value: float) -> None:
    assert len(grouped(value)) < 25
    if isinstance(value, float):
        assert len(with_std(value, abs(value))) < 30


@every(
    ("written", "text"),
    [
        (uncertain(1234.5678, 0.0456), "1234.568 ± 0.046"),
        (uncertain(-0.012326, 0.00067), "−0.01233 ± 0.00067"),
        (uncertain(5.0, 120.0), "5 ± 120"),
        (uncertain(1.2345e8, 3.2e5), "(1.2345 ± 0.0032)×10⁸"),
        (uncertain(2e-9, 1e-10), "(2.00 ± 0.10)×10⁻⁹"),
        (uncertain(1.0, 0.0), "1"),
        (uncertain(np.inf, 1.0), "∞"),
        (uncertain(3.0, np.nan), "3"),
        (with_prefix(999.0), "999"),
        (with_prefix(1000.0), "1 k"),
        (with_prefix(2.5e9), "2.5 G"),
        (
            symbols(rp.Structure(poles=2), "voltage [V]", "speed [rpm]"),
            ["a₁ [1/s]", "a₀ [1/s²]", "b₀ [rpm/V/s²]"],
        ),
        (number(-0.5), "−0.5"),
        (number(123456.0), "123500"),
        (number(2.5e7), "2.5×10⁷"),
        (number(math.nan), "no figure"),
        (uncertain(2.05821, 0.0123), "2.058 ± 0.012"),
        (uncertain(35812.0, 120.0), "35810 ± 120"),
        (uncertain(1.0, None), "1"),
        (uncertain(1.0, math.inf), "1 ± unknown"),
        (duration(81.86), "81.86 s"),
        (duration(50_000.0), "50,000 s (13.9 h)"),
        (interval(0.001), "1 ms"),
        (interval(0.8), "0.8 s"),
        (interval(2.5e-5), "25 us"),
        (interval(math.nan), "no figure"),
        (percent(97.94), "97.9 %"),
        (percent(-2.5e22), "below −1000 %"),
        (percent(-math.inf), "no figure"),
        (off_by(5877.0, 5891.0), "-0.24 %"),
        (off_by(5890.9, 5891.0), "-0.0017 %"),
        (off_by(2.0, 0.0), "no figure"),
        (std_alone(0.01234), "0.012"),
        (std_alone(math.inf), "unknown"),
        (with_std(1.2345678, 0.01), "1.235 +- 0.010"),
        (with_std(0.4700200, 0.0123), "0.470 +- 0.012"),
        (with_std(101.1, 1100.0), "100 +- 1100"),
        (with_std(2.0, math.nan), "2"),
        (of_integrator(3e6, 5e8), "; the slowest pole may be an integrator"),
        (of_integrator(-2.0, 1.0) + of_integrator(2.0, None), ""),
        (with_std(2.2346, None), "2.235"),
        (with_std(2.0, math.inf), "2 +- unknown"),
        (with_std(4.56e-6, 1e-7), "4.56e-06 +- 1e-07"),
        (grouped(59_857, 0), "59,857"),
        (grouped(1234.56), "1,234.6"),
        (grouped(-1e300), "-1e+300"),
        (grouped(10**400, 0), "> 1e+308"),
        (with_prefix(1234567.0), "1.23 M"),
        (with_prefix(65432.1), "65.4 k"),
        (with_prefix(7.0), "7"),
        (complex_number(-2 + 0j), "−2"),
        (complex_number(-1.5 + 76.7j), "−1.5 ± 76.7i"),
        (over(np.linspace(0.0, 2.0, 5), "s"), "0 to 2 s"),
        (over([], "s"), "none"),
        (power_of_ten(0.01), "0.01"),
        (power_of_ten(1e5), "10⁵"),
        (power_of_ten(math.inf), ""),
        (power_of_ten(math.nan), ""),
        (symbol("a10"), "a₁₀"),
        (symbol("bias"), "bias"),
        (gain_unit("flow [1/min]", "y [m]"), "m/(1/min)"),
        (mapped_label("voltage [kV]", "square"), "voltage² [kV²]"),
        (mapped_label("u", "identity"), "u"),
    ],
)
def test_numbers_are_written_as_by_a_person(written: str | list[str], text: str | list[str]) -> None:
    assert written == text
