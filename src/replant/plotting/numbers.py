"""Numbers, symbols with units, and formulas as text for pages (×, −, ±) and terminals (ASCII), and as MathML."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from typing import Any

from replant.model.interop import unit_of, without_unit
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray

MINUS, TIMES, PLUS_MINUS = "−", "×", "±"
UNKNOWN = "unknown"  # text for an infinite standard deviation
PLAIN = 1e6  # smallest magnitude written with a power of ten [number]
WORST_PERCENT = -1000.0  # fit below which the value is not written out [%]
LINE = 42  # width of a line of a polynomial [digits]
WIDEST = 1e12  # smallest magnitude of a grouped number written with a power of ten [number]
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def number(value: float, digits: int = 4) -> str:
    """Return ``value`` with ``digits`` significant digits."""
    if math.isnan(value):
        return "no figure"
    if math.isinf(value):
        return "∞" if value > 0 else MINUS + "∞"
    mantissa, exponent = _parts(value, digits)
    sign = MINUS if value < 0 else ""
    return sign + mantissa + (f"{TIMES}10{str(exponent).translate(_SUPERSCRIPT)}" if exponent else "")


def uncertain(value: float, std: float | None) -> str:
    """Return value and standard deviation, which has two digits; the value is rounded to the same place."""
    if std is not None and math.isinf(std) and math.isfinite(value):
        return f"{number(value)} {PLUS_MINUS} {UNKNOWN}"
    if not std or not (
        math.isfinite(value) and math.isfinite(std)
    ):  # std is 0 for a real pole's damping, which is exactly 1
        return number(value)
    largest = max(abs(value), std)
    power = math.floor(math.log10(largest))
    shift = power if not -3 <= power < 6 else 0
    place = 1 - math.floor(math.log10(std)) + shift
    scaled, spread = (f"{round(x / 10.0**shift, place):.{max(place, 0)}f}" for x in (abs(value), std))
    sign = MINUS if value < 0 else ""
    if abs(value) < std and not shift:  # rounding to the same place might leave 0
        return f"{number(value, 2)} {PLUS_MINUS} {spread}"
    if not shift:
        return f"{sign}{scaled} {PLUS_MINUS} {spread}"
    return f"{sign}({scaled} {PLUS_MINUS} {spread}){TIMES}10{str(shift).translate(_SUPERSCRIPT)}"


def duration(seconds: float) -> str:
    """Return a length of time in s, from 2 h on also in hours."""
    text = f"{seconds:,.0f} s" if 1e4 <= seconds < 1e12 else f"{number(seconds)} s"
    return text + (f" ({seconds / 3600:.3g} h)" if seconds >= 7200 else "")


def interval(seconds: float) -> str:
    """Return a short length of time in s, ms or us, in ASCII."""
    if not math.isfinite(seconds):
        return "no figure"
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if abs(seconds) >= 0.1 * size or not seconds:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds / 1e-9:.4g} ns"


def percent(value: float, *, ascii_only: bool = False) -> str:
    """Return a fit in percent; ``ascii_only`` writes the minus sign as a hyphen, for a terminal."""
    if not math.isfinite(value):
        return "no figure"
    text = f"below {WORST_PERCENT:.0f} %" if value < WORST_PERCENT else f"{value:.1f} %"
    return text if ascii_only else text.replace("-", MINUS)


def off_by(value: float, true: float) -> str:
    """Return the deviation of ``value`` from ``true`` in percent."""
    if true == 0.0:
        return "no figure"
    percent = 100.0 * (value / true - 1.0)
    return f"{percent:+.2f} %" if 0.1 <= abs(percent) < 1e6 else f"{percent:+.2g} %"


def std_alone(std: float) -> str:
    """Return a standard deviation as text for a separate column."""
    return f"{std:.2g}" if math.isfinite(std) else UNKNOWN


def with_std(value: float, std: float | None) -> str:
    """Return a figure with its standard deviation, if known, to the same place and in at most four digits."""
    if std is None or math.isnan(std) or not math.isfinite(value):
        return f"{value:.4g}"
    if math.isinf(std):
        return f"{value:.4g} +- {UNKNOWN}"
    digits = 4
    if value and std > 0.0:
        digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 2
    return f"{_digits(value, min(max(digits, 1), 4))} +- {_digits(std, 2)}"


def of_integrator(gain: float, std: float | None) -> str:
    """Return a remark for a gain with a larger standard deviation: it may be infinite; else an empty text."""
    return "; the slowest pole may be an integrator" if std is not None and std > abs(gain) else ""


def _digits(value: float, digits: int) -> str:
    """Return a figure with ``digits`` digits, trailing zeros included; with a power of ten if it is far from 1."""
    if not 1e-4 <= abs(value) < 1e5:
        return f"{value:.{digits}g}"
    place = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, place):.{max(place, 0)}f}"


def wrapped(text: str, width: int) -> list[str]:
    """Break text into lines of at most ``width`` characters, but not between a figure and its unit."""
    glued = re.sub(r"(?<=\d) (?=(?:%|s|h)(?:\W|$))", "\N{NO-BREAK SPACE}", text)
    lines = textwrap.wrap(glued, max(width, 1), break_long_words=False, break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def grouped(value: float, places: int = 1) -> str:
    """Return a number with commas between groups of three digits, or with a power of ten from `WIDEST` on."""
    try:
        return f"{value:,.{places}f}" if abs(value) < WIDEST else f"{float(value):.4g}"
    except OverflowError:  # an integer beyond float64
        return "> 1e+308"


def rounded(values: FloatArray, digits: int = 6) -> list[float | None]:
    """Round values (N,) to ``digits`` digits for JSON; values that are not finite become None."""
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()]


def with_prefix(value: float) -> str:
    """Return a number with three digits and the SI prefix of its size."""
    for power, letter in ((9, " G"), (6, " M"), (3, " k")):
        if value >= 10.0**power:
            return f"{value / 10.0**power:.3g}{letter}"
    return f"{value:.3g}"


def complex_number(value: complex) -> str:
    """Return a root as text; a complex one, with positive imaginary part, stands for the conjugate pair."""
    real = number(value.real)
    return f"{real} {PLUS_MINUS} {number(abs(value.imag))}i" if value.imag else real


def over(values: Any, unit: str) -> str:
    """Return the first and the last value, with their unit."""
    return f"{values[0]:.4g} to {values[-1]:.4g} {unit}" if len(values) else "none"


def power_of_ten(value: float) -> str:
    """Return a short label of a decade."""
    if not 0.0 < value < math.inf:  # outside of a logarithmic axis
        return ""
    exponent = round(math.log10(value))
    return f"{value:g}" if -3 < exponent < 4 else "10" + str(exponent).translate(_SUPERSCRIPT)


def symbol(name: str) -> str:
    """Return a parameter's name with its index as subscript."""
    return name if name == "bias" else name[0] + name[1:].translate(_SUBSCRIPT)


def symbols(structure: Structure, input_label: str, output_label: str) -> list[str]:
    """Return each parameter's symbol with its unit, in the order of the names."""
    per = gain_unit(input_label, output_label)
    labels = []
    for name in structure.names:
        if name == "bias":
            unit = unit_of(output_label)
        else:
            order = structure.poles - int(name[1:])
            seconds = "s" + (str(order).translate(_SUPERSCRIPT) if order > 1 else "")
            unit = f"1/{seconds}" if name[0] == "a" else f"{per}/{seconds}" if per else ""
        labels.append(with_unit(symbol(name), unit))
    return labels


def fraction(model: TransferFunction) -> list[str]:
    r"""Return G(s) as three lines of text, numerator over denominator."""
    top, _, bottom = str(TransferFunction(model.num, model.den)).partition(" / ")
    top, bottom = top.strip("()"), bottom.strip("()")
    width = max(len(top), len(bottom))
    dead_time = f" exp(-{model.delay:.4g} s)" if model.delay else ""
    return [
        f"       {top:^{width}}".rstrip(),
        f"G(s) = {'-' * width}{dead_time}",
        f"       {bottom:^{width}}".rstrip(),
    ]


def true_parameters(truth: TransferFunction) -> Sequence[float]:
    """Return the coefficients of a transfer function in the order a_{n-1} .. a_0, b_m .. b_0."""
    return [*truth.den[1:].tolist(), *truth.num.tolist()]


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit in brackets, if known."""
    return f"{name} [{unit}]" if unit else name


def gain_unit(input_label: str, output_label: str) -> str:
    """Return the unit of output per input; empty if either is unknown."""
    numerator, denominator = unit_of(output_label), unit_of(input_label)
    if not (numerator and denominator):
        return ""
    compound = any(sign in denominator for sign in "/* ·")
    return f"{numerator}/({denominator})" if compound else f"{numerator}/{denominator}"


def mapped_label(label: str, input_map: object) -> str:
    """Return the label of a mapped input; after a user-defined map it has no unit."""
    if input_map == "identity":
        return label
    unit, name = unit_of(label), without_unit(label)
    return name if input_map != "square" else with_unit(f"{name}²", f"{unit}²" if unit else "")


def mathml(model: TransferFunction) -> str:
    """Return G(s) as MathML; long polynomials have several lines."""
    dead_time = ""
    if model.delay:
        delay = "" if model.delay == 1.0 else _math_number(model.delay)
        dead_time = f"<msup><mi>e</mi><mrow><mo>{MINUS}</mo>{delay}<mi>s</mi></mrow></msup>"
    top, bottom = _lines(model.num), _lines(model.den)
    longest = max(width for _, width in [*top, *bottom]) + 7 + (7 if model.delay else 0)
    name = '<mi>G</mi><mo stretchy="false">(</mo><mi>s</mi><mo stretchy="false">)</mo><mo>=</mo>'
    fraction = f"<mfrac>{_below_each_other(top)}{_below_each_other(bottom)}</mfrac>"
    opening = f'<math display="block" style="--longest:{longest}" alttext="G(s) = {model}">'
    return f"{opening}<mrow>{name}{fraction}{dead_time}</mrow></math>"


def _parts(value: float, digits: int) -> tuple[str, int]:
    """Return the digits of abs(value) and the exponent of ten, 0 if none is needed."""
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


def _below_each_other(lines: list[tuple[str, int]]) -> str:
    rows = [f"<mrow>{line}</mrow>" for line, _ in lines]
    if len(rows) == 1:
        return rows[0]
    return "<mtable>" + "".join(f"<mtr><mtd>{row}</mtd></mtr>" for row in rows) + "</mtable>"


def _lines(coefficients: FloatArray) -> list[tuple[str, int]]:
    """Return a polynomial in s, broken into lines of about ``LINE`` digits, each with its width in digits."""
    lines: list[tuple[str, int]] = []
    for power, value in zip(range(coefficients.size - 1, -1, -1), coefficients.tolist(), strict=True):
        if value == 0.0:
            continue
        term, width = _term(value, power, first=not lines)
        if not lines or lines[-1][1] + width > LINE:
            lines.append((term, width))
        else:
            lines[-1] = (lines[-1][0] + term, lines[-1][1] + width)
    return lines or [("<mn>0</mn>", 1)]


def _term(value: float, power: int, *, first: bool) -> tuple[str, int]:
    """Return a term with its sign, and its width in digits."""
    sign = f"<mo>{MINUS}</mo>" if value < 0 else "" if first else "<mo>+</mo>"
    symbol = "" if power == 0 else "<mi>s</mi>" if power == 1 else f"<msup><mi>s</mi><mn>{power}</mn></msup>"
    factor = "" if symbol and f"{abs(value):.4g}" == "1" else _math_number(value)
    space = '<mspace width="0.15em"></mspace>' if factor and symbol else ""
    mantissa, exponent = _parts(value, 4)
    width = 4 + (len(mantissa) if factor else 0) + (4 if exponent else 0)
    return sign + factor + space + symbol, width
