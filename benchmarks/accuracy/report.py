"""The report: docs/accuracy.md and accuracy.json."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from accuracy.bounds import COVERAGE, Statistics
from accuracy.feedback import FAR_OFF, MOST_WRONG, Outcome, compared
from accuracy.summary import Promise, Summary, is_covered, prints_intervals
from accuracy.verdicts import KINDS, LEAST_TRUSTED, TRUSTED
from accuracy.work import RIGHT, WRONG, Assessed

Verdicts = dict[str, list[Assessed]]
MARK = {True: "met", False: "**not met**"}
BESIDE = {True: "met beside", False: "not met beside"}

FEWEST_RUNS = 100  # from which a coverage is judged
TITLE = "# Accuracy, measured"
INTRODUCTION = """\
*How accurate are the estimates and their standard deviations, measured?*

This page is written by `make accuracy`, which repeats every run (`--scenario A B` runs some scenarios, `--runs N` fewer
runs of each). Run r has the seed r, r = 0, 1, 2 ..; no method is tuned to a scenario beyond what its line names.
"default" is `Identifier(structure, dt)` without further settings, in one pass; "offline SRIVC" is refined instrumental
variables on the whole record at once. Which method to use when: [Which method, when](methods.md).
"""

VERDICTS_NOTE = """\
The input of the second case rests after a tenth of the record, before there is a trusted model; one that was trusted
stays so. The wrong dead time is at least half the slowest time constant: a shorter one may pass. A wrong dt is found by
the time stamps of these records; without stamps nobody could tell."""

EVERY = """\
std is the standard deviation over the runs, printed std the root mean square of the standard deviations that the method
itself gives, failed the number of runs without an estimate. The figures of the poles are in
out/accuracy/accuracy.json."""

NOTES = """\
* **A.** The scenario does not specify the input. Here it is one period of a PRBS of 8 bits held 8 samples (0.4 s, about
  the geometric mean of the plant's two time constants), or a random binary input with the same hold, different in each
  run; a hold of one sample is "beside". The buffered methods have a step size of {step:g} and Lambda(s) = (s + 2)^2
  where it is named, else the filter chosen from the data.
* **B.** The scenario's own bounds hold for the first 100 runs, the coverage is of 200.
* **C.** The random binary input is held 10 samples (0.1 s), about the plant's time constant 1/omega = 0.08 s; holds of
  5 and 20 samples are "beside". The process noise follows from prior knowledge: a quarter of a parameter's range,
  squared, over the time in which the parameter moves through it (0.1, 4.05 and 0 per second); ten times and a tenth of
  it are shown as well. Errors count from the first estimate on (after 5 s). "inside" is how often, at 20 instants, the
  true value lies in the nominal 95 % interval.
* **D.** Voltage and noise differ in each run; every method is given the working point and the squared input.
* **F.** Two interpretations: the input switches at recorded instants only ("recorded"), or also at the instants whose
  samples are lost, which no estimator can know ("unseen"). With a hold of one sample a tenth of the input is then lost.
* **G.** Nominal 95 % intervals of every parameter and of natural frequency f and damping zeta of the poles, slowest
  first. A real pole's damping is always 1 and left out; for A's two real poles f and zeta are those of
  s^2 + a1 s + a0. With 200 runs the measured coverage itself has a standard deviation of 1.5 %. A tracking filter
  (RLS with a memory, Kalman) allows for parameters that move; for constant parameters its intervals are too wide.
* **I.** `Identifier(Structure(poles), dt, startup=len // 10)`; references are independent output-error fits.
* **J.** First-order coloured noise. The default solves the record again up to 10000 samples; for longer records, and
  with a memory, it is a pure recursion. The Cramer-Rao bound knows the colour, and does not know the offset.
* **K.** u and y of a loop, sampled before u is set. The error of a coefficient is in percent of its own size, of a_i at
  least of that which all poles, as fast as they are, would give it. Bias and its standard error are those of the
  coefficient with the largest bias, the RMS error is that of the coefficient with the largest. An estimate is wrong if
  a coefficient is {wrong:g} % off, and has diverged if one is 100 % off or there is none. The anchor compares y with
  what r makes of the whole loop, its controller known, whitened by an autoregression of order 8, begun at the truth; it
  takes about a tenth of a second of processor time a run. Without r only the plants that are stable or integrate have
  a promise on their errors. The published loop is that of Gilson, Garnier, Young and Van den Hof (2008), its errors are
  in percent of the coefficients; the controller in continuous time answers between the samples, which none of the
  methods describes.
"""


def number(value: float, digits: int = 4) -> str:
    """Return a value to so many digits, without an exponent where it can be; a dash for NaN.

    Examples
    --------
    >>> number(1234567.0), number(0.1195), number(float("nan"))
    ('1234567', '0.1195', '-')
    """
    if math.isnan(value):
        return "-"
    if value == 0.0 or not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}g}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{decimals}f}"


LOOP = (
    "loop",
    "method",
    "bias (se), %",
    "RMS, %",
    "over the anchor's",
    "coverage, %",
    "none",
    "diverged",
    "trusted of right",
    "wrong and trusted",
)


def table(header: Sequence[str], rows: Iterator[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]


def markdown(summaries: Sequence[Summary], verdicts: Verdicts) -> str:
    """Return the report as Markdown."""
    from accuracy.linear import STEP_SIZE

    lines = [TITLE, "", INTRODUCTION]
    lines += ["## What is promised, and what was measured", ""]
    lines += ['"beside" marks experiments that no promise covers: a promised one with a harder or an easier input.', ""]
    lines += table(("experiment", "method", "bound", "measured", ""), promised(summaries, verdicts))
    covered = [each for each in summaries if each.experiment.shows_coverage]
    if covered:
        lines += ["", "## G: coverage of nominal 95 % intervals, in percent", ""]
        lines += [f"Bound: {COVERAGE[0]:g} to {COVERAGE[1]:g} % for the default and for offline SRIVC.", ""]
        for summary in covered:
            names = list(summary.experiment.truth)
            lines += [f"{summary.experiment.title}, {_runs(summary)} runs:", ""]
            lines += [*table(("method", *names, ""), _coverage(summary, names)), ""]
    if verdicts:
        lines += ["", "## H: verdicts", "", VERDICTS_NOTE, ""]
        lines += table(("case", "cases", *(TRUSTED,), "other"), _verdicts(verdicts))
    bounded = [each for each in summaries if each.experiment.least_std]
    if bounded:
        lines += ["", "## J: beside the Cramer-Rao bound", ""]
        lines += table(("experiment", "method", "figure", "RMSE", "least std", "ratio"), _beside_least(bounded))
    loops = [each for each in summaries if each.experiment.feedback]
    if loops:
        lines += ["", "## K: plants under a controller", "", *table(LOOP, _loops(loops))]
    lines += ["", "## Every figure", "", EVERY, ""]
    header = ("experiment", "method", "figure", "truth", "mean", "std", "bias", "RMSE", "printed std", "failed")
    lines += table(header, _figures([each for each in summaries if not each.experiment.feedback]))
    lines += ["", "## The experiments", ""]
    lines += [f"* `{each.experiment.key}`: {each.experiment.title}; {_runs(each)} runs." for each in summaries]
    lines += ["", NOTES.format(step=STEP_SIZE, wrong=FAR_OFF)]
    return "\n".join(lines)


def document(summaries: Sequence[Summary], verdicts: Verdicts) -> dict[str, Any]:
    """Return the report for `json`."""
    return {
        "experiments": {each.experiment.key: _as_json(each) for each in summaries},
        "verdicts": {key: [asdict(case) for case in cases] for key, cases in verdicts.items()},
    }


def write(summaries: Sequence[Summary], verdicts: Verdicts, page: Path, data: Path) -> None:
    """Write both files."""
    for path in (page, data):
        path.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(markdown(summaries, verdicts), encoding="utf-8")
    text = json.dumps(_finite(document(summaries, verdicts)), indent=1, allow_nan=False)
    data.write_text(text + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    """Return the same with None for numbers that JSON does not know."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _runs(summary: Summary) -> int:
    return max(each.runs for figures in summary.covered.values() for each in figures.values())


def promised(summaries: Sequence[Summary], verdicts: Verdicts) -> Iterator[Sequence[str]]:
    """Yield a row for each promise: experiment, method, bound, measured, and whether it is met."""
    for summary in summaries:
        for promise in summary.promises:
            yield _line(promise)
        yield from _kept_in_loops(summary)
    yield from _seldom_wrong(summaries)
    for summary in summaries:
        for method in summary.experiment.covered:
            figures = summary.covered[method]
            inside = [each.coverage for each in figures.values()]
            words = f"coverage {COVERAGE[0]:g} to {COVERAGE[1]:g} %"
            measured = f"{min(inside):.1f} to {max(inside):.1f} %"
            yield f"G, {summary.experiment.key}", method, words, measured, _covered_mark(summary, inside)
    if verdicts:
        right = sum(case.status == TRUSTED for case in verdicts.get(RIGHT, []))
        wrong = sum(case.status == TRUSTED for case in verdicts.get(WRONG, []))
        cases = len(verdicts.get(RIGHT, []))
        enough = right >= math.ceil(LEAST_TRUSTED * cases / 30)
        yield RIGHT, "assess()", f"{LEAST_TRUSTED} of 30 trusted", f"{right} of {cases}", MARK[enough]
        yield WRONG, "assess()", "none trusted", f"{wrong} of {len(verdicts.get(WRONG, []))}", MARK[wrong == 0]


def _line(promise: Promise) -> Sequence[str]:
    measured = ", ".join(
        f"{'**' * (name in promise.broken)}{name} {number(value, 3)}{'**' * (name in promise.broken)}"
        for name, value in promise.measured.items()
    )
    mark = (BESIDE if promise.experiment.beside else MARK)[promise.is_met]
    return promise.experiment.key, promise.bound.method, promise.bound.words, measured, mark


def _kept_in_loops(summary: Summary) -> Iterator[Sequence[str]]:
    """Yield a row for each promise on a plant under a controller."""
    feedback = summary.experiment.feedback
    for method in feedback.promised if feedback else ():
        assert feedback is not None
        for words, measured, kept in compared(feedback, summary.outcomes, method):
            yield summary.experiment.key, method, words, measured, "-" if kept is None else MARK[kept]


def _seldom_wrong(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    """Yield a row for each family of loops: how many of all its runs are wrong and trusted."""
    families: dict[tuple[str, str], list[Outcome]] = {}
    for summary in summaries:
        if summary.experiment.feedback:
            for method, family in summary.experiment.feedback.families.items():
                families.setdefault((family, method), []).append(summary.outcomes[method])
    for (family, method), found in families.items():
        wrong, runs = sum(each.wrong_and_trusted for each in found), sum(each.runs for each in found)
        words = f"wrong and trusted in {MOST_WRONG:g} % of all runs at most"
        yield f"K, all {family}", method, words, f"{wrong} of {runs}", MARK[100.0 * wrong <= MOST_WRONG * runs]


def _loops(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    for summary in summaries:
        assert summary.experiment.feedback is not None
        anchor = summary.outcomes.get(summary.experiment.feedback.anchor)
        for method, seen in summary.outcomes.items():
            yield (
                summary.experiment.key,
                method,
                f"{seen.worst} {seen.bias[seen.worst]:+.1f} ({seen.standard_error[seen.worst]:.1f})",
                f"{seen.largest_rms:.1f}",
                f"{seen.largest_rms / anchor.largest_rms:.2f}" if anchor else "-",
                f"{seen.coverage:.0f}",
                str(seen.failed),
                str(seen.diverged),
                f"{seen.right_and_trusted} of {seen.right}" if seen.judges else f"- of {seen.right}",
                f"{seen.wrong_and_trusted} of {seen.runs}" if seen.judges else "-",
            )


def _beside_least(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    """Yield the RMSE of each method beside what no unbiased estimator can go below."""
    for summary in summaries:
        for method, figures in summary.table.items():
            for name, least in summary.experiment.least_std.items():
                rmse = figures[name].rmse
                yield summary.experiment.key, method, name, number(rmse, 3), number(least, 3), f"{rmse / least:.2f}"


def _coverage(summary: Summary, names: Sequence[str]) -> Iterator[Sequence[str]]:
    for method, figures in summary.covered.items():
        if prints_intervals(figures):
            inside = [figures[name].coverage for name in names]
            mark = _covered_mark(summary, inside)
            if method not in summary.experiment.covered:  # nothing is promised of it
                mark = {MARK[True]: "within", MARK[False]: "outside"}.get(mark, mark)
            yield method, *(f"{percent:.1f}" for percent in inside), mark


def _covered_mark(summary: Summary, inside: Sequence[float]) -> str:
    """Return the mark of a row of coverages; they mean nothing over a few runs."""
    if summary.experiment.covered and _runs(summary) < FEWEST_RUNS:
        return f"fewer than {FEWEST_RUNS} runs"
    return MARK[all(is_covered(percent) for percent in inside)]


def _verdicts(verdicts: Verdicts) -> Iterator[Sequence[str]]:
    for kind in ("right", *KINDS):
        said = [case.status for cases in verdicts.values() for case in cases if case.kind == kind]
        if said:
            others = Counter(status for status in said if status != TRUSTED)
            words = ", ".join(f"{count} {status}" for status, count in others.most_common())
            yield kind, str(len(said)), str(said.count(TRUSTED)), words


def _figures(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    for summary in summaries:
        poles = poles_of(summary)
        for method, figures in summary.table.items():
            for name, each in figures.items():
                if name in poles:
                    continue
                yield summary.experiment.key, method, name, *_cells(each)


def poles_of(summary: Summary) -> set[str]:
    """Return the names of the figures that follow from the coefficients: the poles' frequencies and dampings."""
    experiment = summary.experiment
    names = set(experiment.structure.names)
    return set(experiment.truth) - names if names <= set(experiment.truth) else set()


def _cells(each: Statistics) -> tuple[str, ...]:
    bias = f"{number(each.bias_percent, 3)} %" if each.truth and math.isfinite(each.truth) else number(each.bias, 3)
    return (
        number(each.truth),
        number(each.mean),
        number(each.std, 3),
        bias,
        number(each.rmse, 3),
        number(each.printed, 3),
        str(each.failed),
    )


def _as_json(summary: Summary) -> dict[str, Any]:
    experiment = summary.experiment
    return {
        "title": experiment.title,
        "runs": _runs(summary),
        "figures": {
            method: {
                name: asdict(each) | {"bias": each.bias, "coverage": summary.covered[method][name].coverage}
                for name, each in figures.items()
            }
            for method, figures in summary.table.items()
        },
        "least_std": dict(experiment.least_std),
        "in feedback": {method: asdict(each) for method, each in summary.outcomes.items()},
        "bounds": [
            {
                "method": promise.bound.method,
                "bound": promise.bound.words,
                "limits": dict(promise.bound.limits),
                "measured": dict(promise.measured),
                "met": promise.is_met,
            }
            for promise in summary.promises
        ],
    }
