"""How a result shows itself: a few lines at a prompt, and in a notebook these with a picture."""

from __future__ import annotations

import base64
import html
from typing import Any

import numpy as np

from replant.errors import MissingDependencyError


def over(values: Any, unit: str, digits: int = 4) -> str:
    """Return the first and last of some values, with their unit.

    Examples
    --------
    >>> over(np.linspace(0.0, 2.0, 5), "s"), over([], "s")
    ('0 to 2 s', 'none')
    """
    return f"{values[0]:.{digits}g} to {values[-1]:.{digits}g} {unit}" if len(values) else "none"


def with_std(value: float, std: float | None) -> str:
    """Return a value with its standard deviation, where that is known.

    Examples
    --------
    >>> with_std(2.2346, 0.069), with_std(2.2346, None)
    ('2.235 +- 0.069', '2.235')
    """
    return f"{value:.4g}" + ("" if std is None else f" +- {std:.2g}" if np.isfinite(std) else " +- unknown")


def picture(axes: Any) -> str:
    """Return the figure of axes, or of several, as an image of HTML."""
    drawn = np.ravel(np.asarray(axes, dtype=object))[0].figure._repr_png_()
    return f'<img src="data:image/png;base64,{base64.b64encode(drawn).decode()}">'


class Shown:
    """A result with `__repr__` and `plot`, which a notebook shows with its picture; without matplotlib in words."""

    def plot(self) -> Any:
        """Draw the result; return its axes."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        words = f"<p>{html.escape(repr(self))}</p>"
        try:
            return words + picture(self.plot())
        except MissingDependencyError:
            return words
