"""The page docs/accuracy.md: what is promised of each scenario, and what was measured."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from accuracy.results import Row, Tables

_HEAD = """# Accuracy, measured

*How accurate are estimates and standard deviations, measured?*

"default" is `Identifier(structure, dt)`, before `finish`; "offline SRIVC" is `fit`. `make accuracy` writes this page.

{kept} of {all} promises are kept: all of a line, unless it says how many. The figure is that nearest to its limit.
"""

_TAIL = """
## The tables

* {download}`experiments.csv <accuracy/experiments.csv>`: records and numbers of runs.
* {download}`promises.csv <accuracy/promises.csv>`: promises with their limits; "beside": with another input.
* {download}`figures.csv <accuracy/figures.csv>`: every figure; printed_std by the method, least_std by Cramer and Rao.
* {download}`loops.csv <accuracy/loops.csv>`: plants under a controller.
"""

#: What each scenario is.
SCENARIOS = {
    "A": "second order, 10 dB of white noise",
    "B": "fourth order, 10 and 0 dB",
    "C": "a plant that changes",
    "D": "the demo's actuator",
    "E": "no noise",
    "F": "a tenth of the samples lost, 20 % jitter",
    "I": "recorded logs, beside output-error fits",
    "J": "coloured noise, beside the Cramer-Rao bound",
    "K": "under a controller, beside an estimator that knows it",
    "H": "verdicts on 30 right models and 30 wrong ones",
}
_NUMBER = r"-?\d[\d.]*(?:e[-+]?\d+)?"
_NUMBERS = rf"{_NUMBER}(?:, {_NUMBER})*"


def page(tables: Tables) -> str:
    """Return the page."""
    rows = [row for row in tables["promises"] if not row["beside"]]
    judged = [row for row in rows if row["kept"]]
    lines = [_HEAD.format(kept=sum(row["kept"] == "yes" for row in judged), all=len(judged))]
    for letter, title in SCENARIOS.items():
        mine = [row for row in rows if row["experiment"].startswith(letter)]
        if mine:
            lines += [f"* **{letter}: {title}**", *(f"  - {line}" for line in _lines(mine))]
    lines += _broken(tables["promises"])
    return "\n".join(lines) + "\n" + _TAIL


def _lines(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a line for the methods of a scenario that promise the same; what differs in its limits is one promise."""
    lines: dict[str, list[str]] = {}
    for (methods, _), found in _alike(rows).items():
        kept = [row["kept"] == "yes" for row in found if row["kept"]]
        told = "" if all(kept) else f" ({sum(kept)} of {len(kept)})"
        figure = measured([(promised(row), row["measured"]) for row in found if row["kept"]])
        lines.setdefault(methods, []).append(f"{shortened(list(map(promised, found)))}: {figure}{told}")
    for methods, promises in lines.items():
        yield f"{methods}: {'; '.join(promises)}"


def _alike(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return rows by their methods and by what they promise but for its numbers."""
    methods: dict[str, list[str]] = {}
    for row in rows:
        methods.setdefault(promised(row), []).append(row["method"].split(",")[0])
    alike: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        words = promised(row)
        names = ", ".join(dict.fromkeys(methods[words]))
        alike.setdefault((names, re.sub(_NUMBERS, "#", words)), []).append(row)
    return alike


def promised(row: Row) -> str:
    """Return what is promised; that the reference is given is said by the method."""
    return row["promise"].replace(", with r", "")


def measured(rows: Sequence[tuple[str, str]]) -> str:
    """Return what was measured for several promises: counts added up, the figure nearest to its limit, else the range.

    Examples
    --------
    >>> measured([("std at most 1, 2", "a0 0.8, b0 1.4"), ("std at most 1, 3", "a0 0.5, b0 1.8")])
    'a0 0.8'
    >>> measured([("mean within 2 %", "a0 -1.5"), ("mean within 3 % or 2 standard errors", "a0 1.6 (se 1)")])
    'a0 -1.5 %'
    >>> measured([("", "3 of 4"), ("", "5 of 5")]), measured([("", "1.05 (of 9)"), ("", "91.0 to 92.5 %")])
    ('8 of 9', '1.05 to 92.5')
    """
    counts = [re.match(r"(\d+) of (\d+)", text) for _, text in rows]
    if all(counts):
        return f"{sum(int(each[1]) for each in counts if each)} of {sum(int(each[2]) for each in counts if each)}"
    plain = [(promise, re.sub(r" \(.*?\)", "", text)) for promise, text in rows]
    promise, first = plain[0]
    if "at least" in promise or not first[0].isalpha():
        name = re.match(r"[a-z]+ |", first)
        span = between([number for _, text in plain for number in re.findall(_NUMBER, text)])
        return (name[0] if name else "") + span + " %" * ("%" in first)
    return max(found for row in plain for found in _shares(*row))[1]


def _shares(promise: str, text: str) -> Iterator[tuple[float, str]]:
    """Yield each figure, and how near to its limit it is."""
    near = " % of " in promise  # "std within 20 % of ..": as far above as below
    limits = [float(each) for each in re.findall(_NUMBER, promise.split(" % of ")[-1].split(" or ")[0])]
    unit = " %" * bool(re.search(r"within [^a-z]*%", promise) and not near)
    figures = text.split(", ")
    own = limits if len(limits) == len(figures) else limits[:1] * len(figures)
    for each, limit in zip(figures, own, strict=True):
        yield abs(float(each.split()[-1]) / limit - near), each + unit


def shortened(promises: Sequence[str]) -> str:
    """Return promises that differ in their numbers as one, with the least and the greatest of each.

    Examples
    --------
    >>> shortened(["std at most 0.2, 0.1, 0.3"]), shortened(["within 2 % in 90 %", "within 3 % in 90 %"])
    ('std at most 0.1 to 0.3', 'within 2 to 3 % in 90 %')
    """
    places = zip(*(re.findall(_NUMBERS, promise) for promise in promises), strict=True)
    numbers = (between(", ".join(place).split(", ")) for place in places)
    return re.sub(_NUMBERS, lambda _: next(numbers), promises[0])


def between(numbers: Sequence[str]) -> str:
    """Return the least and the greatest number.

    Examples
    --------
    >>> between(["3", "-1", "2.0"]), between(["4"])
    ('-1 to 3', '4')
    """
    low, high = min(numbers, key=float), max(numbers, key=float)
    return low if low == high else f"{low} to {high}"


def _broken(rows: Sequence[Row]) -> Iterator[str]:
    """Yield what is not kept."""
    for title, beside in (("Not kept", ""), ("Not kept beside", "beside")):
        found = [row for row in rows if row["kept"] == "no" and row["beside"] == beside]
        if found:
            yield f"\n{title}:\n"
        for experiment in dict.fromkeys(row["experiment"] for row in found):
            mine = [row for row in found if row["experiment"] == experiment]
            yield f"* {experiment}: {'; '.join(_failures(mine))}"


def _failures(rows: Sequence[Row]) -> Iterator[str]:
    """Yield what is not within the limits, which stand above, of each method."""
    for (methods, _), found in _alike(rows).items():
        figures = " / ".join(measured([(promised(row), row["measured"])]) for row in found)
        yield f"{methods}: {figure_of(found[0])} {figures}"


def figure_of(row: Row) -> str:
    """Return what is limited by a promise.

    Examples
    --------
    >>> figure_of({"promise": "std at most 0.2"}), figure_of({"promise": "coverage 90 to 99 %"})
    ('std', 'coverage')
    """
    return re.split(r" at most| within| in| \d", promised(row))[0]
