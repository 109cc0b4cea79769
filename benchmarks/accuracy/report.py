"""The page docs/accuracy.md: what is promised of each scenario, and what was measured."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from accuracy.results import Row, Tables

_HEAD = """# Accuracy, measured

*How accurate are the estimates and their standard deviations, measured?*

`make accuracy` repeats every run, and writes this page and its tables. "default" is `Identifier(structure, dt)`, in one
pass; "offline SRIVC" is refined instrumental variables on the whole record. [Which method, when](methods.md).

{kept} of {all} promises are kept. "Measured" is the figure nearest to its limit, of all experiments.
"""

_TAIL = """
## The tables

* {download}`experiments.csv <accuracy/experiments.csv>`: records, and numbers of runs.
* {download}`promises.csv <accuracy/promises.csv>`: each promise with all its limits. "beside": with a harder or
  an easier input than promised.
* {download}`figures.csv <accuracy/figures.csv>`: every figure; std over the runs, printed_std by the method itself,
  coverage of its 95 % intervals, least_std by Cramer and Rao.
* {download}`loops.csv <accuracy/loops.csv>`: plants under a controller. The anchor knows the controller.
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


def page(tables: Tables) -> str:
    """Return the page."""
    rows = [row for row in tables["promises"] if not row["beside"]]
    judged = [row for row in rows if row["kept"]]
    lines = [_HEAD.format(kept=sum(row["kept"] == "yes" for row in judged), all=len(judged))]
    lines += ["| promise | kept | measured |", "|---|---|---|"]
    for letter, title in SCENARIOS.items():
        mine = [row for row in rows if row["experiment"].startswith(letter)]
        if mine:
            lines += [f"| **{letter}: {title}** | | |", *_lines(mine)]
    lines += _broken(tables["promises"])
    return "\n".join(lines) + "\n" + _TAIL


def _lines(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a line for each promise of a scenario; promises on recorded logs that differ in their limit share one."""
    alike: dict[str, list[Row]] = {}
    for row in rows:
        alike.setdefault(re.sub(rf"(?<=at least ){_NUMBER}", "", row["promise"]), []).append(row)
    for words, found in alike.items():
        limits = [row["promise"].removeprefix(words) for row in found]
        promise = found[0]["promise"] if not any(limits) else f"{words}{between(limits)}"
        methods = " / ".join(dict.fromkeys(row["method"].split(",")[0] for row in found))
        judged = [row for row in found if row["kept"]]
        kept = f"{sum(row['kept'] == 'yes' for row in judged)} of {len(judged)}"
        yield f"| {methods}: {shortened(promise)} | {kept} | {measured(promise, [row['measured'] for row in judged])} |"


def measured(promise: str, texts: Sequence[str]) -> str:
    """Return what several experiments measured: counts added up, the figure nearest to its limit, else the range.

    Examples
    --------
    >>> measured("std at most 1, 2", ["a0 0.8, b0 1.4", "a0 0.5, b0 1.8"]), measured("mean within 2 %", ["a0 -1.5"])
    ('b0 1.8', 'a0 -1.5 %')
    >>> measured("", ["3 of 4", "5 of 5"]), measured("", ["1.05 (of 9)", "0.9"]), measured("", ["91.0 to 92.5 %"])
    ('8 of 9', '0.9 to 1.05', '91.0 to 92.5 %')
    """
    counts = [re.match(r"(\d+) of (\d+)", text) for text in texts]
    if all(counts):
        return f"{sum(int(each[1]) for each in counts if each)} of {sum(int(each[2]) for each in counts if each)}"
    plain = [re.sub(r" \(.*?\)", "", text) for text in texts]
    if "at least" in promise or not plain[0][0].isalpha():
        name = re.match(r"[a-z]+ |", plain[0])
        span = between([number for text in plain for number in re.findall(_NUMBER, text)])
        return (name[0] if name else "") + span + " %" * ("%" in plain[0])
    near = " % of " in promise  # "std within 20 % of ..": as far above as below
    limits = [float(each) for each in re.findall(_NUMBER, promise.split(" % of ")[-1])]
    found = []
    for text in plain:
        figures = text.split(", ")
        own = limits if len(limits) == len(figures) else limits[:1] * len(figures)
        shares = [abs(float(each.split()[-1]) / limit - near) for each, limit in zip(figures, own, strict=True)]
        found += zip(shares, figures, strict=True)
    in_percent = re.search(r"within [^a-z]*%", promise) and not near
    return max(found)[1] + " %" * bool(in_percent)


def shortened(promise: str) -> str:
    """Return a promise with the least and the greatest of its limits.

    Examples
    --------
    >>> shortened("std at most 0.2, 0.1, 0.3"), shortened("within 1, 2 %")
    ('std at most 0.1 to 0.3', 'within 1, 2 %')
    """
    several = rf"{_NUMBER}(?:, {_NUMBER}){{2,}}"
    return re.sub(several, lambda found: between(found[0].split(", ")), promise)


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
            yield f"* {experiment}: {'; '.join(map(_failure, mine))}"


def _failure(row: Row) -> str:
    """Return a promise that is not kept, and what was measured."""
    return f"{row['method']}: {shortened(row['promise'])}: {re.sub(r' [(].*?[)]', '', row['measured'])}"
