"""A figure of matplotlib that notebooks show, without pyplot."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A `matplotlib.figure.Figure` that a notebook shows where a cell ends in it.

    Notebooks show figures of pyplot, or all figures after ``%matplotlib inline``.  This one draws itself.
    """

    def _repr_png_(self) -> bytes:
        """Return the figure as PNG, which IPython asks an object for."""
        drawn = io.BytesIO()
        self.savefig(drawn, format="png")
        return drawn.getvalue()
