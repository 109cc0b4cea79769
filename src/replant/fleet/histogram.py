"""Histograms of a fleet's figures, as SVG in the colours of the page."""

from __future__ import annotations

import html

import numpy as np

from replant.arguments import FloatArray
from replant.report.number_format import number

WIDTH, HEIGHT, FOOT = 300, 90, 22  # size of the picture, and of the part for its axis [px]
MOST_BARS = 40  # bars at most: few rigs get fewer [count]
REACH = 6.0  # half of the width drawn, beside the interquartile range; rigs beyond are counted in words [number]


def histogram(name: str, values: FloatArray, unit: str = "") -> str:
    """Return the distribution of a figure over the rigs as a ``figure`` element."""
    known = np.sort(values[np.isfinite(values)])
    if not known.size:
        return ""
    middle, begin, end = _range(known)
    beyond = int((known < begin).sum() + (known > end).sum())
    bars = int(np.clip(np.sqrt(known.size), 8, MOST_BARS))
    counts, _ = np.histogram(known, bars, (begin, end))
    top, width = max(int(counts.max()), 1), WIDTH / bars
    drawn = "".join(
        f'<rect x="{k * width:.2f}" y="{HEIGHT * (1 - count / top):.2f}" width="{max(width - 1, 1):.2f}" '
        f'height="{HEIGHT * count / top:.2f}"/>'
        for k, count in enumerate(counts.tolist())
        if count
    )
    at = WIDTH * (middle - begin) / (end - begin)
    said = f"{name}: median {number(middle)}{f' {unit}' if unit else ''}"
    more = f"; {'one rig lies' if beyond == 1 else f'{beyond:,} rigs lie'} beyond the axis" if beyond else ""
    picture = (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT + FOOT}" role="img" aria-label="{html.escape(said + more)}">{drawn}'
        f'<path class="axis" d="M0 {HEIGHT}h{WIDTH}"/><path class="middle" d="M{at:.1f} 0v{HEIGHT}"/>'
        f'<text x="0" y="{HEIGHT + 16}">{number(begin, 3)}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT + 16}" text-anchor="end">{number(end, 3)}</text></svg>'
    )
    label = html.escape(name + (f" [{unit}]" if unit else ""))
    told = html.escape(said.partition(": ")[2] + more)
    return f"<figure><figcaption>{label}<small>{told}</small></figcaption>{picture}</figure>"


def _range(known: FloatArray) -> tuple[float, float, float]:
    """Return the median, and the ends of the axis: those of the values, but not farther than `REACH`."""
    low, middle, high = (float(value) for value in np.quantile(known, (0.25, 0.5, 0.75)))
    reach = REACH * (high - low)
    begin, end = max(float(known[0]), middle - reach), min(float(known[-1]), middle + reach)
    if not end > begin:
        width = 0.5 * abs(middle) or 0.5
        begin, end = middle - width, middle + width
    return middle, begin, end
