"""Palette: colours, fonts and blank figures that all plots share, and the symbols of parameters.

The colours are those of Okabe and Ito, which readers with a colour vision deficiency can distinguish.  Where two of
them are equally light, line styles must differ as well, so that a figure is readable in grey.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, MissingDependencyError, shown

BLACK, ORANGE, SKY, GREEN = "#000000", "#e69f00", "#56b4e9", "#009e73"
BLUE, VERMILION, PURPLE, GREY = "#0072b2", "#d55e00", "#cc79a7", "#7f8c95"
NAVY = "#00436b"  # blue, darkened: beside vermilion, which is as light as blue in grey

#: How a true value is drawn, in every figure.
TRUE = {"color": BLACK, "ls": (0, (5, 3)), "lw": 0.9, "zorder": 2.5}

FONT: Any = {"font.size": 9.0, "axes.titlesize": 9.0, "legend.fontsize": 8.5, "svg.hashsalt": "replant"}


def blank_figure(width: float, height: float) -> Any:
    """Return an empty `matplotlib.figure.Figure` of a width and height in inches, with constrained layout.

    The figure is independent of pyplot: it has no window and need not be closed.  A notebook shows it.

    >>> blank_figure(7.0, 4.0).get_size_inches().tolist()
    [7.0, 4.0]
    """
    try:
        from replant.plotting.figure import ShownFigure
    except ImportError as cause:
        raise MissingDependencyError("plots need matplotlib: pip install 'replant[report]'") from cause
    return ShownFigure(figsize=(width, height), layout="constrained")


def given_axes(name: str, axes: Any, count: int) -> list[Any]:
    """Return axes, one or any nesting of several, as a list of ``count``; ``name`` is the argument's in messages."""
    found = list(np.asarray(axes, dtype=object).ravel())
    if not all(hasattr(axis, "set_xlim") for axis in found):
        raise ArgumentTypeError(f"{name} must be axes of matplotlib, got {shown(axes)}")
    if len(found) != count:
        raise InvalidArgumentError(f"{name} must be {count} axes, got {len(found)}")
    return found


def font() -> Any:
    """Return a context in which figures are made and saved with the project's font sizes."""
    import matplotlib as mpl

    return mpl.rc_context(FONT)


def symbol(name: str) -> str:
    """Return a parameter's name as mathematical text of matplotlib.

    Examples
    --------
    >>> symbol("a0"), symbol("bias")
    ('$a_{0}$', 'bias')
    """
    return f"${name[0]}_{{{name[1:]}}}$" if name[1:].isdigit() else name


def open_frame(axis: Any) -> None:
    """Remove the top and right spine of an axis, and draw a faint grid."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="#dddddd", lw=0.5)
    axis.set_axisbelow(True)
