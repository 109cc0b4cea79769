"""A row of units below the names: which row is one, and how its units join the columns' names."""

from __future__ import annotations

import re
from collections.abc import Sequence

from replant.data.logs.text_cells import is_number
from replant.interop.units import unit_of

_BRACKETED = re.compile(r"[\[(]\s*([^\[\]()]{0,30}?)\s*[\])]")
_PREFIXED = r"[numµμkMGcdhT]?(?:m|g|A|V|W|N|Nm|J|K|Pa|Hz|Ω|[Oo]hm|C|F|H|T|L|l|mol|s|rad|bar|VA|Wh|eV|B|Bd|dB|t)"
_OTHERS = (
    r"%|‰|°[CFK]?|℃|deg(?:C|F|K)?|rpm|RPM|U/min|rev|sec|second|seconds|min|minutes|h|hr|hours|d|days|counts?|psi|in|ft|"
    r"lbf|inch|ppm|px|digits?|inc|volts?|amps?|ampere|newton|met(?:er|re)s?|degrees?|radians?|-"
)
_ATOM = rf"(?:{_PREFIXED}|{_OTHERS})(?:\^?-?\d|[²³]|⁻[¹²³])?"
_UNIT = re.compile(rf"(?:1\s*/\s*)?{_ATOM}(?:\s*[*·/ ]\s*{_ATOM})*")
_NONE = frozenset({"", "-", "1"})


def units_in(cells: Sequence[str]) -> list[str] | None:
    """Return the units in the cells of a row; None if the row is none of units.

    Each cell is a unit in brackets, a known unit or empty, and one of them tells more than that there is none.

    Examples
    --------
    >>> units_in(["[s]", "[V]", "[mm]"]), units_in(["s", "V", "mm/s^2"]), units_in(["s", "-", ""])
    (['s', 'V', 'mm'], ['s', 'V', 'mm/s^2'], ['s', '', ''])
    >>> units_in(["s", "V", "1/min"])
    ['s', 'V', '1/min']
    >>> units_in(["0", "V", "mm"]), units_in(["RUN", "STOP", ""]), units_in(["", "-"])
    (None, None, None)
    """
    units = []
    for cell in cells:
        bracketed = _BRACKETED.fullmatch(cell.strip())
        text = bracketed[1] if bracketed else cell.strip()
        if text and not bracketed and not _is_unit(text):
            return None
        units.append("" if text in _NONE else text)
    return units if any(units) else None


def _is_unit(text: str) -> bool:
    return _UNIT.fullmatch(text) is not None and (text == "nA" or not is_number(text, None))  # na stands for no value


def with_units(names: Sequence[str], units: Sequence[str]) -> tuple[str, ...]:
    """Return the names with the units of those that have none in their names.

    Examples
    --------
    >>> with_units(["t", "u [mV]", "state"], ["s", "V", ""])
    ('t [s]', 'u [mV]', 'state')
    """
    given = [*units, *[""] * (len(names) - len(units))]
    return tuple(
        f"{name} [{unit}]" if unit and not unit_of(name) else name for name, unit in zip(names, given, strict=False)
    )
