"""Units: the unit at the end of a signal's name."""

from __future__ import annotations

import re

_INDEX = r"[\d\s:,]+[\])]"  # of a MATLAB column, as in data.y[:,0]: no unit
_UNIT = rf"\s*[\[(](?!{_INDEX})([^\[\]()]+)[\])]\s*$"


def unit_of(label: str) -> str:
    """Return the unit in brackets at the end of a label; an empty string if there is none.

    Examples
    --------
    >>> unit_of("speed [rpm]"), unit_of("force (N)"), unit_of("flow [1/min]"), unit_of("u"), unit_of("data.y[:,0]")
    ('rpm', 'N', '1/min', '', '')
    """
    found = re.search(_UNIT, label)
    return found[1].strip() if found else ""


def without_unit(label: str) -> str:
    """Return a label without its unit.

    Examples
    --------
    >>> without_unit("speed [rpm]"), without_unit("u"), without_unit("data.y[:,0]")
    ('speed', 'u', 'data.y[:,0]')
    """
    return re.sub(_UNIT, "", label)
