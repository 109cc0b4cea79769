"""The report of a result as one self-contained HTML page."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from replant.estimation.filters import StateVariableFilter
from replant.estimation.optimizers import RecursiveLeastSquares
from replant.estimation.settings import Settings
from replant.fitting.search_result import SearchResult
from replant.fitting.validation import Validation
from replant.logs.log import Log
from replant.model.preprocess import Preprocess
from replant.online.runs.result import Result
from replant.plotting.diagrams import draw_correlation, draw_validation
from replant.plotting.numbers import gain_unit, mathml, number, of_integrator, percent, uncertain, with_unit
from replant.report import contents as tables
from replant.report import figures, results_as_text
from replant.report import page_frame as page
from replant.report.contents import Material
from replant.report.findings import BAD, GOOD, WARN, Finding, findings
from replant.report.python_programs import run_as_python
from replant.verdict.verdict import percent as share

HEADINGS = ("log", "simulated", "one step", "offset", "residual beyond its limit", "error by frequency", "verdict")


def section(validations: Sequence[tuple[str, Validation]]) -> str:
    """Return the section on validations by other logs; empty without one."""
    rows, pictures = [], []
    for place, (name, found) in enumerate(validations):
        (auto, cross), worst = found.outside, None if found.by_frequency is None else found.by_frequency.worst
        outside = "–" if math.isnan(auto) else f"{100 * auto:.0f} % with itself, {100 * cross:.0f} % with the input"
        error = "–" if worst is None else f"up to {share(worst)}" if worst else "none beyond chance"
        fits = percent(found.fit), percent(found.one_step)
        rows.append((name, *fits, number(found.offset, 4), outside, error, found.verdict.status))
        said = f"{name}: measured output and the model's, {found.how}, with offset and initial state estimated. "
        said += " ".join(f"{reason[0].upper()}{reason[1:]}." for reason in found.verdict.reasons)
        axes = draw_validation(found, size=(page.WHOLE, 4.6))
        pictures.append(drawn(said, page.svg(axes[0].figure, f"other{place}", said)))
    listed = page.table(HEADINGS, rows, "Validation on other logs", "table wide")
    return page.section("On other logs", listed, *pictures) if rows else ""


NO_MODEL = "<p>G(s) could not be estimated.</p>"
DO_NOT_USE = page.note("Do not use this model: see the verdict above.")
CONTRADICTED = page.note("The samples contradict this model: see the verdict above.")
BESIDE = 3  # most poles of a G(s) that is short enough to be beside the key figures [count]


def write_report(
    path: Path,
    result: Result,
    log: Log,
    *,
    filter: StateVariableFilter | None = None,  # noqa: A002 - the field's word
    preprocess: Preprocess | None = None,
    truth: Sequence[float] | None = None,
    command: str = "",
    python: str = "",
    title: str = "",
    candidates: SearchResult | None = None,
    validations: Sequence[tuple[str, Validation]] = (),
    advice: tuple[str, str] | None = None,
) -> Path:
    """Write the report of ``result`` into one self-contained HTML file, and return its path."""
    settings = result.settings
    if settings is not None:
        filter, preprocess = filter or result.fixed_filter, preprocess or settings.preprocess  # noqa: A001
        python = python or run_as_python(result, log)
    material, found = Material(result, log, filter, preprocess or Preprocess(), truth), findings(result, len(log))
    note = CONTRADICTED if found[0].gravity == BAD else ""
    part = ("", result.model, material.plant_label, log.output_name)
    with page.look(), np.errstate(all="ignore"):  # values that are not finite are reported as text
        plots = page.charts_of(material.panels)
        fields = {
            "verdict": verdict_of(found, advice),
            "model_note": note if all(each.usable for each in found) else DO_NOT_USE,
            "long": " long" if result.structure.poles > BESIDE else "",
            "math": mathml(result.transfer_function) if result.has_model else NO_MODEL,
            "figures": _figures(material),
            "zoom": page.asset("zoom.html"),
            **_pictures(material, plots),
            "pole_table": tables.poles(material),
            "other_logs": section(validations),
            "candidates": "" if candidates is None else candidates_of(candidates),
            "coefficients": page.folded("Coefficients", tables.coefficients([part], truth)),
            "reproduce": page.folded("How to reproduce this", reproduction(command, python)),
            "origin": page.folded("Record and versions", tables.origin(material)),
        }
    title = title or log.path.name or "Simulated record"
    return with_plots(path, "report.html", fields, plots, title=title, lede=_lede(material))


def with_plots(path: Path, template: str, fields: dict[str, str], plots: Any, *, title: str, lede: str) -> Path:
    """Write a report from its template, with the data of its plots and the scripts for them."""
    library, css = page.uplot()
    return page.write_page(
        path, title=title, eyebrow="Identified model", lede=lede, body=page.filled(template, fields), css=css,
        data=plots, scripts=(library, page.script("format.js", "chart.js", "report.js")),
    )  # fmt: skip


def candidates_of(found: SearchResult) -> str:
    """Return the folded table of a search, with a note on the candidates that it omits."""
    tried = page.table(results_as_text.HEADINGS, results_as_text.rows_of(found), "Structures tried", "table wide")
    return page.folded("Structures tried", tried + (page.note(found.rest) if found.rest else ""))


def _pictures(material: Material, plots: dict[str, list[dict[str, Any]]]) -> dict[str, str]:
    """Return the figures, each with its caption."""
    result, dt, found, said = material.result, material.log.dt, material.correlations, tables.captions(material)
    truth = None if material.truth is None else result.structure.transfer_function(np.array(material.truth))
    of: dict[str, Any] = {"truth": truth, **material.labels}
    residual = tables.on_grid(material.residual, material.log)

    def still(name: str, height: float, draw: Callable[[Any], object], width: float = page.HALF, **more: Any) -> str:
        return drawn(said[name], page.picture(name, said[name], (width, height), draw, **more))

    def over_time(name: str) -> str:
        panels = material.panels[name]
        return drawn(said[name], page.time_picture(name, panels, said[name]), plots[name]) if panels else ""

    def draw_bode(axes: Any) -> None:
        figures.draw_bode(result, dt, axes=axes, **of)

    parameters = over_time("parameters")
    spectrum = still("spectrum", 2.9, lambda axis: figures.draw_spectrum(result.noise, residual, dt, ax=axis))
    return {
        "fit": over_time("fit"),
        "transients": f"<h3>Parameter estimates</h3>{parameters}" if parameters else "",
        "excitation": page.folded("Excitation", over_time("excitation")),
        "auto": still("auto", 2.3, lambda axis: draw_correlation(found, dt, axis)),
        "cross": still("cross", 2.3, lambda axis: draw_correlation(found, dt, axis, "input")),
        "poles": still("poles", 4.2, lambda axis: figures.draw_poles_and_zeros(result, truth=truth, ax=axis)),
        "bode": still("bode", 4.2, draw_bode, rows=2, height_ratios=(3, 2)),
        "step": still("step", 2.6, lambda axis: figures.draw_step(result, ax=axis, **of), width=page.WHOLE),
        "spectrum": page.folded("Spectrum of what is left", spectrum),
    }


def drawn(said: str, picture: str, plots: Sequence[dict[str, Any]] = ()) -> str:
    """Return a figure: static pictures and, if there are plots, elements for the zoomable ones."""
    columns = " halves" if len(plots) > 1 and not any(plot["name"] == "output" for plot in plots) else ""
    live = f'<div class="live{columns}">{"".join(map(_room, plots))}</div>' if plots else ""
    kind = ' class="both"' if plots else ""
    return f'<figure{kind}>{live}<div class="still">{picture}</div><figcaption>{page.words(said)}</figcaption></figure>'


def _room(plot: dict[str, Any]) -> str:
    name, label = html.escape(plot["name"]), html.escape(plot["label"])
    said = "no estimate" if name.startswith("parameter") else "no finite values"
    nothing = f'<p class="nothing">{said}</p>' if plot["empty"] else ""
    keys = "Arrow keys pan, plus and minus zoom, Escape shows everything."
    return (
        f'<div class="chart"><div class="head"><span class="name">{label}</span><span class="legend"></span></div>'
        f'<div class="plot" id="{name}" tabindex="0" role="group" aria-label="{label} over time. {keys}" '
        f'style="height:{plot["height"]}px">{nothing}</div></div>'
    )


def _lede(material: Material) -> str:
    result, log = material.result, material.log
    how = "fitted to the whole record"
    if result.history is not None:
        how = "identified online" + (f" by {_method(result.settings)}" if result.settings else "")
    return f"{log.input_name} → {log.output_name}, {how}; {len(log):,} samples, {tables.lasts(log)}"


def _method(settings: Settings) -> str:
    """Return the name of the estimator."""
    if settings.instruments and isinstance(settings.optimizer, RecursiveLeastSquares):
        return "recursive refined instrumental variables"
    return type(settings.optimizer).__name__ + (" with instruments" if settings.instruments else "")


def verdict_of(found: Sequence[Finding], advice: tuple[str, str] | None, of: str = "") -> str:
    """Return the verdict: whether a model, or the row ``of`` an output, may be used, the advice, and the reasons."""
    first = found[0]
    # for a trusted model the verdict comes before the warnings, but they give it their colour
    lead = next((each for each in found if each.gravity == GOOD), first) if first.gravity == WARN else first
    others = [each for each in found if each is not lead]
    more = "".join(
        f'<li class="{other.gravity}">{page.icon(other.gravity)}<span><b>{html.escape(other.headline)}.</b> '
        f"{page.words(other.text)}</span></li>"
        for other in others
    )
    reasons = "".join(f"<p>{page.words(each)}</p>" for each in lead.more)
    count = "one more reason" if len(lead.more) == 1 else f"{len(lead.more)} more reasons"
    headline = f"{of}: {lead.headline}" if of else lead.headline
    if advice is not None:
        headline += f": {advice[0]}"
        reasons += page.code("shell", advice[1])
        count = f"{count}, and the command" if lead.more else "the command"
    return (
        f'<section class="verdict {first.gravity}" aria-label="Verdict">{page.icon(first.gravity)}<div>'
        f"<h2>{html.escape(headline)}</h2><p>{page.words(lead.text)}</p>"
        + (f"<ul>{more}</ul>" if more else "")
        + (f'<details class="fold"><summary>{count.capitalize()}</summary>{reasons}</details>' if reasons else "")
        + "</div></section>"
    )


def _figures(material: Material) -> str:
    """Return the key figures."""
    result, known = material.result, material.result.uncertainty
    unit = gain_unit(material.plant_label, material.log.output_name)
    gain, gain_std = result.transfer_function.dc_gain, None if known is None else known.dc_gain_std
    entries = [
        (percent(result.simulation.fit), f"fit, {result.simulation.how}"),
        (percent(result.one_step), "fit, one step ahead"),
        (uncertain(gain, gain_std), with_unit("DC gain", unit) + of_integrator(gain, gain_std)),
        (f"{result.used:,}", "samples used"),
    ]
    return page.key_figures(entries)


def reproduction(command: str, python: str) -> str:
    """Return the command and the program that reproduce a result."""
    parts = [("In a shell", "shell", command), ("In Python", "python", python)]
    return "".join(f"<h3>{name}</h3>{page.code(kind, text)}" for name, kind, text in parts if text)
