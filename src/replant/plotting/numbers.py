"""Numbers and formulas as text for pages (×, −, ±) and terminals (ASCII), and as MathML."""

from __future__ import annotations

import math

from replant.arguments import FloatArray
from replant.model.transfer_function import TransferFunction

MINUS, TIMES, PLUS_MINUS = "−", "×", "±"
UNKNOWN = "unknown"  # in place of a standard deviation that is infinite
PLAIN = 1e6  # magnitude from which on a power of ten is split off [number]
WORST_PERCENT = -1000.0  # fit below which it does not matter how bad it is [%]
LINE = 42  # width of a line of a polynomial [digits]
WIDEST = 1e12  # magnitude from which on a grouped number is written with a power of ten [number]
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 4) -> str:
    """Return ``value`` with that many significant digits.

    Examples
    --------
    >>> number(-0.5), number(123456.0), number(2.5e7), number(float("nan"))
    ('−0.5', '123500', '2.5×10⁷', 'no figure')
    """
    if math.isnan(value):
        return "no figure"
    if math.isinf(value):
        return "∞" if value > 0 else MINUS + "∞"
    mantissa, exponent = _parts(value, digits)
    sign = MINUS if value < 0 else ""
    return sign + mantissa + (f"{TIMES}10{str(exponent).translate(_SUPERSCRIPT)}" if exponent else "")


def uncertain(value: float, std: float | None, digits: int = 4) -> str:
    """Return value and standard deviation, the latter with two digits and the value to the same place.

    Examples
    --------
    >>> uncertain(2.05821, 0.0123), uncertain(35812.0, 120.0), uncertain(1.0, None), uncertain(1.0, math.inf)
    ('2.058 ± 0.012', '35810 ± 120', '1', '1 ± unknown')
    """
    if std is not None and math.isinf(std) and math.isfinite(value):
        return f"{number(value, digits)} {PLUS_MINUS} {UNKNOWN}"
    if not std or not (math.isfinite(value) and math.isfinite(std)):  # a std of 0: a real pole's damping is just 1
        return number(value, digits)
    largest = max(abs(value), std)
    power = math.floor(math.log10(largest))
    shift = power if not -3 <= power < 6 else 0
    place = 1 - math.floor(math.log10(std)) + shift
    scaled, spread = (f"{round(x / 10.0**shift, place):.{max(place, 0)}f}" for x in (abs(value), std))
    sign = MINUS if value < 0 else ""
    if abs(value) < std and not shift:  # what is left of it, or nothing would be
        return f"{number(value, 2)} {PLUS_MINUS} {spread}"
    if not shift:
        return f"{sign}{scaled} {PLUS_MINUS} {spread}"
    return f"{sign}({scaled} {PLUS_MINUS} {spread}){TIMES}10{str(shift).translate(_SUPERSCRIPT)}"


def duration(seconds: float) -> str:
    """Return a length of time in s, and in hours where those are more than a handful.

    Examples
    --------
    >>> duration(81.86), duration(50_000.0)
    ('81.86 s', '50,000 s (13.9 h)')
    """
    text = f"{seconds:,.0f} s" if 1e4 <= seconds < 1e12 else f"{number(seconds)} s"
    return text + (f" ({seconds / 3600:.3g} h)" if seconds >= 7200 else "")


def interval(seconds: float) -> str:
    """Return a short length of time in s, ms or us, in ASCII.

    Examples
    --------
    >>> interval(0.001), interval(0.8), interval(2.5e-5), interval(math.nan)
    ('1 ms', '0.8 s', '25 us', 'no figure')
    """
    if not math.isfinite(seconds):
        return "no figure"
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if abs(seconds) >= 0.1 * size or not seconds:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds / 1e-9:.4g} ns"


def percent(value: float, *, ascii_only: bool = False) -> str:
    """Return a fit in percent; ``ascii_only`` writes the minus sign as a hyphen, for a terminal.

    Examples
    --------
    >>> percent(97.94), percent(-2.5e22), percent(float("-inf"))
    ('97.9 %', 'below −1000 %', 'no figure')
    """
    if not math.isfinite(value):
        return "no figure"
    text = f"below {WORST_PERCENT:.0f} %" if value < WORST_PERCENT else f"{value:.1f} %"
    return text if ascii_only else text.replace("-", MINUS)


def off_by(value: float, true: float) -> str:
    """Return how far ``value`` is from ``true``, in percent.

    Examples
    --------
    >>> off_by(5877.0, 5891.0), off_by(5890.9, 5891.0), off_by(2.0, 0.0)
    ('-0.24 %', '-0.0017 %', 'no figure')
    """
    if true == 0.0:
        return "no figure"
    percent = 100.0 * (value / true - 1.0)
    return f"{percent:+.2f} %" if 0.1 <= abs(percent) < 1e6 else f"{percent:+.2g} %"


def std_alone(std: float) -> str:
    """Write a standard deviation that stands in a column of its own.

    Examples
    --------
    >>> std_alone(0.01234), std_alone(math.inf)
    ('0.012', 'unknown')
    """
    return f"{std:.2g}" if math.isfinite(std) else UNKNOWN


def with_std(value: float, std: float) -> str:
    """Write a figure with its standard deviation, where one is known: to the same place, in four digits at the most.

    Examples
    --------
    >>> with_std(1.2345678, 0.01), with_std(0.4700200, 0.0123), with_std(101.1, 1100.0), with_std(2.0, math.nan)
    ('1.235 +- 0.010', '0.470 +- 0.012', '100 +- 1100', '2')
    >>> with_std(2.0, math.inf)
    '2 +- unknown'
    """
    if math.isinf(std) and math.isfinite(value):
        return f"{value:.4g} +- {UNKNOWN}"
    if not math.isfinite(std):
        return f"{value:.4g}"
    digits = 4
    if value and std > 0.0 and math.isfinite(value):
        digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 2
    return f"{_digits(value, min(max(digits, 1), 4))} +- {_digits(std, 2)}"


def _digits(value: float, digits: int) -> str:
    """Return a figure with so many digits, zeros at the end among them, and a power of ten only where it is far from 1.

    Examples
    --------
    >>> _digits(0.47002, 3), _digits(1099.0, 2), _digits(4.5e-6, 2), _digits(0.0, 2)
    ('0.470', '1100', '4.5e-06', '0')
    """
    if not 1e-4 <= abs(value) < 1e5:
        return f"{value:.{digits}g}"
    place = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, place):.{max(place, 0)}f}"


def grouped(value: float, places: int = 1) -> str:
    """Return a number with commas between groups of three digits; from `WIDEST` on with a power of ten.

    Examples
    --------
    >>> grouped(59_857, 0), grouped(1234.56), grouped(-1e300), grouped(10**400, 0)
    ('59,857', '1,234.6', '-1e+300', '> 1e+308')
    """
    try:
        return f"{value:,.{places}f}" if abs(value) < WIDEST else f"{float(value):.4g}"
    except OverflowError:  # an integer beyond float64
        return "> 1e+308"


def with_prefix(value: float) -> str:
    """Return a number with three digits and the SI prefix of its size.

    Examples
    --------
    >>> with_prefix(1234567.0), with_prefix(65432.1), with_prefix(7.0)
    ('1.23 M', '65.4 k', '7')
    """
    for power, letter in ((9, " G"), (6, " M"), (3, " k")):
        if value >= 10.0**power:
            return f"{value / 10.0**power:.3g}{letter}"
    return f"{value:.3g}"


def complex_number(value: complex, digits: int = 4) -> str:
    """Return a root; of a conjugate pair, given with positive imaginary part, both.

    Examples
    --------
    >>> complex_number(-2 + 0j), complex_number(-1.5 + 76.7j)
    ('−2', '−1.5 ± 76.7i')
    """
    real = number(value.real, digits)
    return f"{real} {PLUS_MINUS} {number(abs(value.imag), digits)}i" if value.imag else real


def mathml(model: TransferFunction) -> str:
    """Return G(s) as MathML, long polynomials in several lines."""
    dead_time = ""
    if model.delay:
        delay = "" if model.delay == 1.0 else _math_number(model.delay)
        dead_time = f"<msup><mi>e</mi><mrow><mo>{MINUS}</mo>{delay}<mi>s</mi></mrow></msup>"
    lines = [*_lines(model.num), *_lines(model.den)]
    longest = max(map(_width, lines)) + 7 + (7 if model.delay else 0)
    name = '<mi>G</mi><mo stretchy="false">(</mo><mi>s</mi><mo stretchy="false">)</mo><mo>=</mo>'
    fraction = f"<mfrac>{_polynomial(model.num)}{_polynomial(model.den)}</mfrac>"
    opening = f'<math display="block" style="--longest:{longest}" alttext="G(s) = {model}">'
    return f"{opening}<mrow>{name}{fraction}{dead_time}</mrow></math>"


def _parts(value: float, digits: int) -> tuple[str, int]:
    """Return the digits of abs(value) and a power of ten, 0 where none is needed."""
    text = f"{abs(value):.{digits}g}"
    if "e" not in text:
        return text, 0
    if 1.0 <= abs(float(text)) < PLAIN:
        return f"{float(text):.0f}", 0
    mantissa, _, exponent = f"{abs(value):.{digits - 1}e}".partition("e")
    return mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa, int(exponent)


def _math_number(value: float) -> str:
    mantissa, exponent = _parts(value, 4)
    if not exponent:
        return f"<mn>{mantissa}</mn>"
    power = f"<mn>{exponent}</mn>" if exponent > 0 else f"<mrow><mo>{MINUS}</mo><mn>{-exponent}</mn></mrow>"
    return f"<mn>{mantissa}</mn><mo>{TIMES}</mo><msup><mn>10</mn>{power}</msup>"


def _polynomial(coefficients: FloatArray) -> str:
    """Return a polynomial in s, broken into lines of about ``LINE`` digits."""
    lines = [f"<mrow>{''.join(term for term, _ in line)}</mrow>" for line in _lines(coefficients)]
    if len(lines) == 1:
        return lines[0]
    return "<mtable>" + "".join(f"<mtr><mtd>{line}</mtd></mtr>" for line in lines) + "</mtable>"


def _lines(coefficients: FloatArray) -> list[list[tuple[str, int]]]:
    """Return the terms of a polynomial line by line, each with its width in digits."""
    order = coefficients.size - 1
    lines: list[list[tuple[str, int]]] = [[]]
    for i, value in enumerate(coefficients.tolist()):
        if value == 0.0:
            continue
        term = _term(value, order - i, first=lines == [[]])
        if lines[-1] and _width(lines[-1]) + term[1] > LINE:
            lines.append([])
        lines[-1].append(term)
    return lines if lines[0] else [[("<mn>0</mn>", 1)]]


def _width(line: list[tuple[str, int]]) -> int:
    return sum(width for _, width in line)


def _term(value: float, power: int, *, first: bool) -> tuple[str, int]:
    """Return a term with its sign, and its width in digits."""
    sign = f"<mo>{MINUS}</mo>" if value < 0 else "" if first else "<mo>+</mo>"
    symbol = "" if power == 0 else "<mi>s</mi>" if power == 1 else f"<msup><mi>s</mi><mn>{power}</mn></msup>"
    factor = "" if symbol and f"{abs(value):.4g}" == "1" else _math_number(value)
    space = '<mspace width="0.15em"></mspace>' if factor and symbol else ""
    mantissa, exponent = _parts(value, 4)
    width = 4 + (len(mantissa) if factor else 0) + (4 if exponent else 0)
    return sign + factor + space + symbol, width
