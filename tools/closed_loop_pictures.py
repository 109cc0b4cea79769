"""Runs the example of docs/closed-loop.md: writes what it prints into the page, and draws its pictures.

    python tools/closed_loop_pictures.py

The Python blocks of the page run in their order and share their names.  What a block prints stands in the ``text``
block that follows it.  The pictures are drawn from the same names, so that they show what the page computes.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from replant.plotting.palette import BLACK, BLUE, GREEN, ORANGE, TRUE, VERMILION, font, symbol
from replant.report.figures.style import INK, MUTED, legend, logarithmic, new_axes, tidy

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "closed-loop.md"
PICTURES = ROOT / "docs" / "pictures"
BLOCK = re.compile(r"```python\n(.*?)```\n(?:(\n```text\n)(.*?)```\n)?", re.DOTALL)
"""A block of Python, and what it prints where a block of text follows it."""

Names = dict[str, Any]
WIDTH = 7.6
"""Width of a picture [inches]."""


def blocks(page: str) -> list[str]:
    r"""Return the Python blocks of a page.

    Examples
    --------
    >>> blocks("A\n```python\nx = 1\n```\n\n```text\n2\n```\n")
    ['x = 1\n']
    """
    return [block[1] for block in BLOCK.finditer(page)]


def run(codes: list[str], names: Names) -> Iterator[str]:
    """Run blocks one after another in one namespace, and yield what each prints."""
    for number, code in enumerate(codes, 1):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, f"{PAGE.name}, block {number}", "exec"), names)
        yield printed.getvalue()


def with_outputs(page: str, outputs: list[str]) -> str:
    r"""Return a page with what its blocks print, in the order of the blocks.

    Examples
    --------
    >>> with_outputs("```python\nprint(2)\n```\n\n```text\nold\n```\n", ["2\n"])
    '```python\nprint(2)\n```\n\n```text\n2\n```\n'
    """
    printed = iter(outputs)

    def written(block: re.Match[str]) -> str:
        output = next(printed)
        return block[0] if block[2] is None else f"```python\n{block[1]}```\n{block[2]}{output}```\n"

    return BLOCK.sub(written, page)


# --- the pictures


def draw_record(names: Names) -> Any:
    """Draw a minute of the loop: set-point and output, input, and the load."""
    dt, shown = names["DT"], 900
    t = dt * np.arange(shown)
    top, middle, bottom = new_axes(3, 1, (WIDTH, 4.6), sharex=True, height_ratios=[3, 2, 2])[:, 0]
    top.plot(t, names["y"][:shown], color=BLUE, lw=1.1, label="output y")
    top.step(t, names["r"][:shown], color=VERMILION, lw=1.3, where="post", label="reference r, the set-point")
    middle.step(t, names["u"][:shown], color=GREEN, lw=0.9, where="post", label="input u, which the controller makes")
    bottom.step(t, names["load"][:shown], color=MUTED, lw=0.9, where="post", label="load, which nobody measures")
    for axis in (top, middle, bottom):
        tidy(axis)
        legend(axis, 2)
        axis.set_xlim(0.0, t[-1])
    bottom.set_xlabel("time [s]")
    return top.figure


def draw_coefficients(names: Names) -> Any:
    """Draw the coefficients that each method finds, with two standard deviations, beside the true ones."""
    found = {
        "least squares": (names["blind"].parameters, None),
        "instruments, no noise model": (names["unwhitened"].parameters, names["unwhitened"].uncertainty.std),
        "default, from u and y": (names["plain"].parameters, names["plain"].uncertainty.std),
        "default, with the reference": (names["ident"].parameters, names["ident"].uncertainty.std),
    }
    colours = (MUTED, ORANGE, BLUE, VERMILION)
    axes = new_axes(1, 3, (WIDTH, 2.1), sharey=True)[0]
    for axis, name, place, true in zip(axes, names["plain"].names, range(3), names["TRUE"], strict=True):
        tidy(axis)
        axis.axvline(true, **TRUE)
        for row, ((values, std), colour) in enumerate(zip(found.values(), colours, strict=True)):
            band = None if std is None else 2.0 * std[place]
            axis.errorbar(values[place], -row, xerr=band, fmt="o", color=colour, ms=5, lw=1.6, capsize=3)
        axis.set_xlabel(f"{symbol(name)}, true value {true:g}")
        axis.set_yticks([-row for row in range(len(found))], list(found))
        axis.set_ylim(-len(found) + 0.5, 0.5)
        axis.grid(axis="y", visible=False)
        axis.tick_params(axis="y", length=0, labelcolor=INK)
    return axes[0].figure


def true_spectrum(names: Names, omega: Any) -> Any:
    """Return the power spectral density of what load and sensor add to the output, per Hz."""
    dt, z = names["DT"], np.exp(1j * omega * names["DT"])
    numerator, denominator, _ = names["cont2discrete"]((names["NUMERATOR"], names["DENOMINATOR"]), dt, "zoh")
    plant = np.polyval(numerator[0], z) / np.polyval(denominator, z)
    load = names["LOAD"] / (1.0 - names["SLOW"] / z)
    return dt * (np.abs(plant * load) ** 2 + names["NOISE"] ** 2)


def draw_noise(names: Names) -> Any:
    """Draw the spectrum of the noise model, and the true one."""
    dt = names["DT"]
    omega = np.geomspace(0.05, np.pi / dt, 400)
    axis = new_axes(1, 1, (WIDTH, 2.9))[0, 0]
    axis.loglog(omega, true_spectrum(names, omega), color=BLACK, lw=1.2, ls=TRUE["ls"], label="true")
    axis.loglog(omega, names["ident"].noise.spectrum(omega), color=VERMILION, lw=1.6, label="identified")
    tidy(axis)
    logarithmic(axis.xaxis)
    logarithmic(axis.yaxis)
    legend(axis, 2)
    axis.set_xlabel("frequency [rad/s]")
    axis.set_ylabel("noise in y [1/Hz]")
    axis.set_xlim(omega[0], omega[-1])
    return axis.figure


def draw_unstable(names: Names) -> Any:
    """Draw the loop around the unstable plant, and its pole as it is identified."""
    dt, shown = names["DT_2"], 800
    t = dt * np.arange(shown)
    top, bottom = new_axes(2, 1, (WIDTH, 4.2))[:, 0]
    top.plot(t, names["y_2"][:shown], color=BLUE, lw=1.1, label="output y")
    top.step(t, names["r_2"][:shown], color=VERMILION, lw=1.2, where="post", label="reference r")
    top.set_xlim(0.0, t[-1])
    steps = np.array(names["pole_at"])
    plain, (pole, std) = np.array(names["pole_plain"])[:, 0], np.array(names["pole_referenced"]).T
    bottom.fill_between(dt * steps, pole - 2 * std, pole + 2 * std, color=VERMILION, alpha=0.18, lw=0)
    bottom.plot(dt * steps, pole, color=VERMILION, lw=1.6, label="with the reference, and two standard deviations")
    bottom.plot(dt * steps, plain, color=BLUE, lw=1.2, ls=":", marker="o", ms=3, label="from u and y")
    bottom.axhline(1.0, **TRUE)
    bottom.set_ylabel("pole [rad/s]")
    for axis in (top, bottom):
        tidy(axis)
        legend(axis, 2)
        axis.set_xlabel("time [s]")
    return top.figure


DRAWN = {
    "closed-loop-record.png": draw_record,
    "closed-loop-coefficients.png": draw_coefficients,
    "closed-loop-noise.png": draw_noise,
    "closed-loop-unstable.png": draw_unstable,
}


def main() -> None:
    """Run the page, write its outputs, draw its pictures."""
    page, names = PAGE.read_text(encoding="utf-8"), Names()
    outputs = []
    for output in run(blocks(page), names):
        outputs.append(output)
        sys.stdout.write(output + "---\n")
    PAGE.write_text(with_outputs(page, outputs), encoding="utf-8")
    with font():
        for name, draw in DRAWN.items():
            draw(names).savefig(PICTURES / name, dpi=130, facecolor="white", metadata={"Software": None})


if __name__ == "__main__":
    main()
