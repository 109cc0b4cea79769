"""A polynomial in s as text."""

from __future__ import annotations

from replant.numerics.arguments import FloatArray


def polynomial_text(polynomial: FloatArray) -> str:
    """Return a polynomial in s (descending powers) as text, in brackets if it has more than one term.

    Examples
    --------
    >>> import numpy as np
    >>> polynomial_text(np.array([1.0, -4.0, 0.5])), polynomial_text(np.array([2.0]))
    ('(s^2 - 4 s + 0.5)', '2')
    """
    order = polynomial.size - 1
    terms = []
    for i, value in enumerate(polynomial.tolist()):
        power = order - i
        if value == 0.0 and order > 0:
            continue
        symbol = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        size = f"{abs(value):.4g}"
        body = symbol if symbol and size == "1" else f"{size} {symbol}".strip()
        sign = "-" if value < 0 else "+"
        terms.append((sign, body))
    if not terms:
        return "0"
    text = ("-" if terms[0][0] == "-" else "") + terms[0][1]
    text += "".join(f" {sign} {body}" for sign, body in terms[1:])
    return f"({text})" if len(terms) > 1 else text
