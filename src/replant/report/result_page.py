"""The report of one output or several, each with one input or several, as one self-contained HTML page."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.estimation.filters import StateVariableFilter
from replant.estimation.optimizers import RecursiveLeastSquares
from replant.estimation.settings import Settings
from replant.fitting.miso_fit import RowFit
from replant.fitting.model import Model
from replant.fitting.search_result import SearchResult
from replant.fitting.validation import Validation
from replant.logs.log import Log
from replant.model.preprocess import Preprocess
from replant.online.runs.result import Result
from replant.plotting import style
from replant.plotting.diagrams import ABOVE_LEGEND, draw_correlation, draw_spectrum, draw_validation
from replant.plotting.numbers import mathml, number, of_integrator, percent, uncertain, with_unit
from replant.report import contents as tables
from replant.report import page_frame as page
from replant.report import results_as_text
from replant.report.findings import BAD, GOOD, WARN, Finding, findings
from replant.report.outputs import Output, on_grid, panels_of
from replant.report.panels import draw_bode_of, draw_poles_of, draw_step_of, unit_of_gain
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
        pictures.append(figure(said, page.svg(axes[0].figure, f"other{place}", said)))
    listed = page.table(HEADINGS, rows, "Validation on other logs", "table wide")
    return page.section("On other logs", listed, *pictures) if rows else ""


NO_MODEL = "<p>G(s) could not be estimated.</p>"
DO_NOT_USE = page.note("Do not use this model: see the verdict above.")
CONTRADICTED = page.note("The samples contradict this model: see the verdict above.")
BESIDE = 3  # most poles of a G(s) that is short enough to be beside the key figures [count]
SMALLEST = 2.6  # least width of a picture of a matrix [inches]


def write_report(
    path: Path,
    result: Result | RowFit,
    log: Log,
    *,
    filter: StateVariableFilter | None = None,  # noqa: A002 - the field's word
    preprocess: Preprocess | None = None,
    truth: Sequence[float] | None = None,
    candidates: SearchResult | None = None,
    **about: Any,
) -> Path:
    """Write the report of ``result`` into one self-contained HTML file, and return its path."""
    if isinstance(result, Result) and result.settings is not None:
        filter, preprocess = filter or result.fixed_filter, preprocess or result.settings.preprocess  # noqa: A001
        about["python"] = about.get("python") or run_as_python(result, log)
    output = Output(result, log, filter, preprocess or Preprocess(), truth)
    return write_outputs(path, [output], candidates="" if candidates is None else candidates_of(candidates), **about)


def write_outputs(
    path: Path,
    outputs: Sequence[Output],
    *,
    command: str = "",
    python: str = "",
    title: str = "",
    candidates: str = "",
    validations: Sequence[tuple[str, Validation]] = (),
    advice: tuple[str, str] | None = None,
) -> Path:
    """Write the report of ``outputs`` into one self-contained HTML file, and return its path."""
    several, models = len(outputs) > 1, [model for output in outputs for model in output.models]
    alone = len(models) == 1
    with page.look(), np.errstate(all="ignore"):  # values that are not finite are reported as text
        found = [findings(each.fitted, len(each.log)) for each in outputs]
        panels, said = panels_of(outputs), tables.captions(outputs)
        plots = page.charts_of(panels)

        def over_time(name: str) -> str:
            drawn = panels[name]
            return figure(said[name], page.time_picture(name, drawn, said[name]), plots=plots[name]) if drawn else ""

        parameters, excitation = over_time("parameters"), over_time("excitation")
        is_long = alone and models[0].structure.poles > BESIDE
        fields = {
            "verdicts": "".join(
                verdict_of(each, advice, output.name if several else "")
                for each, output in zip(found, outputs, strict=True)
            ),
            "kind": " rows" if not alone else " long" if is_long else "",
            "models": "".join(_models(*each, alone=alone) for each in zip(outputs, found, strict=True)),
            "columns": str(len(outputs[0].models)),
            "figures": "".join(_figures(each, several=several) for each in outputs),
            "zoom": page.asset("zoom.html"),
            "fit": over_time("fit"),
            "left": "".join(_left(k, each, several=several) for k, each in enumerate(outputs)),
            "transients": f"<h3>Parameter estimates</h3>{parameters}" if parameters else "",
            "dynamics": _dynamics(outputs, models, said),
            "other_logs": section(validations),
            "candidates": candidates,
            "coefficients": page.folded("Coefficients", tables.coefficients(models, outputs[0].truth)),
            "spectrum": page.folded("Spectrum of what is left", _spectra(outputs)),
            "excitation": page.folded("Excitation", excitation) if excitation else "",
            "reproduce": page.folded("How to reproduce this", reproduction(command, python)),
            "origin": page.folded("Record and versions", tables.origin(outputs)),
        }
    library, css = page.uplot()
    return page.write_page(
        path, title=title or outputs[0].log.path.name or "Simulated record", eyebrow="Identified model",
        lede=_lede(outputs), body=page.filled("report.html", fields), css=css, data=plots,
        scripts=(library, page.script("format.js", "chart.js", "report.js")),
    )  # fmt: skip


def _lede(outputs: Sequence[Output]) -> str:
    first, names = outputs[0], ", ".join(each.name for each in outputs)
    how, log = "", first.log
    if isinstance(first.fitted, Result):
        how = ", fitted to the whole record"
        if (run := first.fitted).history is not None:
            how = ", identified online" + (f" by {_method(run.settings)}" if run.settings else "")
    return f"{', '.join(log.input_names)} → {names}{how}; {len(log):,} samples, {tables.lasts(log)}"


def _models(output: Output, found: Sequence[Finding], *, alone: bool) -> str:
    """Return each G(s) of an output, and whether it may be used."""
    said = CONTRADICTED if found[0].gravity == BAD else ""
    said = said if all(each.usable for each in found) else DO_NOT_USE
    parts = []
    for model in output.models:
        name = "Transfer function" if alone else f"G(s), {tables.way(model)}"
        formula = mathml(model.transfer_function) if output.result.has_model and model.parameters.any() else NO_MODEL
        region = f'<div class="math" tabindex="0" role="region" aria-label="{html.escape(name)}">{formula}</div>'
        parts.append(f"<div>{'' if alone else page.note(tables.way(model))}{region}{said}</div>")
    return "".join(parts)


def _figures(output: Output, *, several: bool) -> str:
    """Return the key figures."""
    result, of = output.result, f"{output.name}: " if several else ""
    entries = [
        (percent(result.simulation.fit), f"{of}fit, {output.how}"),
        (percent(result.one_step), f"{of}fit, one step ahead"),
    ]
    for model in output.models if len(output.models) == 1 else ():
        gain, known = model.transfer_function.dc_gain, model.uncertainty
        std = None if known is None else known.dc_gain_std
        entries.append(
            (uncertain(gain, std), of + with_unit("DC gain", unit_of_gain(model)) + of_integrator(gain, std))
        )
    entries.append((f"{result.used:,}", f"{of}samples used"))
    return page.key_figures(entries) + ("<div></div>" if several and len(entries) < 4 else "")


def _left(place: int, output: Output, *, several: bool) -> str:
    """Return the residual's correlation with itself and with each input."""
    parts, found = [f"<h3>{html.escape(output.name)}</h3>" if several else ""], output.correlations
    for i, (name, each) in enumerate([("", next(iter(found.values()))), *found.items()]):
        said = tables.correlation_in_words(each, name) + tables.on_clock(output)
        draw = partial(draw_correlation, each, output.log.dt, name=name)
        parts.append(_still(f"left{place}-{i}", said, 2.3, draw))
    return "".join(parts)


def _spectra(outputs: Sequence[Output]) -> str:
    """Return the spectrum of each residual."""
    parts = []
    for k, output in enumerate(outputs):
        said = (f"{output.name}: " if len(outputs) > 1 else "") + tables.of_spectrum(output)
        residual = on_grid(output.residual, output.log)
        parts.append(
            _still(f"spectrum{k}", said, 2.9, partial(draw_spectrum, output.result.noise, residual, output.log.dt))
        )
    return "".join(parts)


def _still(name: str, said: str, height: float, draw: Callable[[Any], object]) -> str:
    return figure(said, page.picture(name, said, (page.HALF, height), draw))


def _dynamics(outputs: Sequence[Output], models: Sequence[Model], said: dict[str, str]) -> str:
    """Return the section on dynamics: a picture of each kind and pair of input and output, and tables."""
    alone, columns, true = len(models) == 1, max(len(outputs[0].models), 2), outputs[0].truth
    truth = None if true is None else outputs[0].result.structure.transfer_function(np.array(true))

    def pictures(name: str, words: str, height: float, draw: Callable[..., object], **layout: Any) -> str:
        size = (page.WHOLE if alone and name == "step" else max(SMALLEST, 2.0 * page.HALF / columns), height)
        cells = []
        for k, model in enumerate(models):

            def titled(axes: Any, model: Model = model) -> None:
                draw(model, axes, truth)
                if not alone:
                    style.title(np.ravel(axes)[0], tables.way(model), ABOVE_LEGEND)

            row, column = divmod(k, len(outputs[0].models))
            one = said[name] if alone else f"{words} from {model.input_name} to {model.output_name}"
            cells.append(page.picture(f"{name}{row}-{column}", one, size, titled, **layout))
        heading = "" if alone and name != "step" else f"<h3>{words}{'' if alone else 's'}</h3>"
        return heading + figure(said[name], "".join(cells), columns=0 if alone else columns)

    draw_bode = partial(draw_bode_of, dt=outputs[0].log.dt)
    bode = pictures("bode", "Bode diagram", 4.2, draw_bode, rows=2, height_ratios=(3, 2))
    poles = pictures("poles", "Pole-zero map", 4.2 if alone else 3.0, draw_poles_of)
    step = pictures("step", "Step response", 2.6, draw_step_of)
    first = f'<div class="pair">{bode}{poles}</div>{step}'
    if not alone:
        first = f'<div class="tables">{tables.gains(models)}</div>{step}{bode}{poles}'
    return f'{first}<div class="tables"><h3>Poles and zeros</h3>{tables.poles_and_zeros(models)}</div>'


def figure(said: str, picture: str, *, plots: Sequence[dict[str, Any]] = (), columns: int = 0) -> str:
    """Return a figure: static pictures, in ``columns`` if given, and elements for zoomable plots."""
    halves = " halves" if len(plots) > 1 and not any(plot["name"] == "output" for plot in plots) else ""
    live = f'<div class="live{halves}">{"".join(map(_room, plots))}</div>' if plots else ""
    kind = ' class="both"' if plots else ""
    still = f'panels" style="--columns:{columns}' if columns else "still"
    return (
        f'<figure{kind}>{live}<div class="{still}">{picture}</div><figcaption>{page.words(said)}</figcaption></figure>'
    )


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


def candidates_of(found: SearchResult) -> str:
    """Return the folded table of a search, with a note on the candidates that it omits."""
    tried = page.table(results_as_text.HEADINGS, results_as_text.rows_of(found), "Structures tried", "table wide")
    return page.folded("Structures tried", tried + (page.note(found.rest) if found.rest else ""))


def reproduction(command: str, python: str) -> str:
    """Return the command and the program that reproduce a result."""
    parts = [("In a shell", "shell", command), ("In Python", "python", python)]
    return "".join(f"<h3>{name}</h3>{page.code(kind, text)}" for name, kind, text in parts if text)
