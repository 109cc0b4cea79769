"""The option that is a band of frequencies."""

from __future__ import annotations

import math
from typing import Any

import click

Edges = tuple[float | None, float | None]


class Band(click.ParamType[Edges]):
    """The type of options that are a band of frequencies in Hz, such as 0.1:10; an edge that is left out is open."""

    name = "band"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Edges:
        """Return the two edges in Hz.

        >>> Band().convert("0.1:10", None, None), Band().convert(":10Hz", None, None)
        ((0.1, 10.0), (None, 10.0))
        """
        if isinstance(value, tuple):
            return value
        low, colon, high = str(value).partition(":")
        try:
            edges = _edge(low), _edge(high)
        except ValueError:
            edges = None, None
        if not colon or edges == (None, None):
            self.fail(f"{value!r} is no band of frequencies; write 0.1:10, 0.1: or :10, in Hz", param, ctx)
        return edges

    def written(self, band: Edges) -> str:
        """Return a band as `convert` reads it.

        Examples
        --------
        >>> Band().written((0.1, None))
        '0.1:'
        """
        return ":".join("" if edge is None else f"{edge:.12g}" for edge in band)


def words_of(low: float | None, high: float | None) -> str:
    """Return a band in words.

    Examples
    --------
    >>> words_of(0.1, 10.0), words_of(0.1, None)
    ('0.1 to 10 Hz', '0.1 Hz and more')
    """
    if high is None:
        return f"{low:g} Hz and more"
    return f"{high:g} Hz and less" if low is None else f"{low:g} to {high:g} Hz"


def _edge(text: str) -> float | None:
    text = text.strip().removesuffix("Hz").strip()
    if not text:
        return None
    edge = float(text)
    if not 0.0 < edge < math.inf:
        raise ValueError(text)
    return edge
