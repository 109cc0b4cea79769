"""Labels: the unit that the name of a signal ends with."""

from __future__ import annotations

import re

_UNIT = r"\s*[\[(]([^\[\]()]+)[\])]\s*$"


def unit_of(label: str) -> str:
    """Return the unit that a label ends with, in brackets; empty where there is none.

    Examples
    --------
    >>> unit_of("speed [rpm]"), unit_of("force (N)"), unit_of("u")
    ('rpm', 'N', '')
    """
    found = re.search(_UNIT, label)
    return found[1].strip() if found else ""


def without_unit(label: str) -> str:
    """Return a label less its unit.

    Examples
    --------
    >>> without_unit("speed [rpm]"), without_unit("u")
    ('speed', 'u')
    """
    return re.sub(_UNIT, "", label)
