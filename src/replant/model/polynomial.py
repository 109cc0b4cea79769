"""A polynomial in s as text."""

from __future__ import annotations

from collections.abc import Callable

from replant.numerics.arguments import FloatArray


def polynomial_text(polynomial: FloatArray) -> str:
    """Return a polynomial in s (descending powers) as text, in brackets if it has more than one term.

    >>> import numpy as np
    >>> polynomial_text(np.array([1.0, -4.0, 0.5])), polynomial_text(np.array([2.0]))
    ('(s^2 - 4 s + 0.5)', '2')
    """
    terms = terms_of(polynomial, lambda value: f"{value:.4g}", " ", "s^{}")
    return f"({''.join(terms)})" if len(terms) > 1 else terms[0]


def terms_of(polynomial: FloatArray, number: Callable[[float], str], times: str, power_of_s: str) -> list[str]:
    """Return the terms of a polynomial, each with its sign: ``number`` writes a coefficient, ``times`` follows."""
    terms: list[str] = []
    for power, value in zip(range(polynomial.size - 1, -1, -1), polynomial.tolist(), strict=True):
        if value == 0.0 and polynomial.size > 1:
            continue
        symbol = "" if power == 0 else "s" if power == 1 else power_of_s.format(power)
        size = number(abs(value))
        body = symbol if symbol and size == "1" else f"{size}{times}{symbol}" if symbol else size
        sign = "-" if value < 0 else "+" if terms else ""
        terms.append(f" {sign} {body}" if terms else f"{sign}{body}")
    return terms or ["0"]
