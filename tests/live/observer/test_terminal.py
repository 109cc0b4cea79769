"""The status at the terminal: short, within its columns, and silent after the terminal was closed."""

from __future__ import annotations

import dataclasses
import io
import re

import numpy as np
import pytest
from rich.console import Console

import replant as rp
from replant.live.observer.terminal import TerminalStatus, render, status_line
from support.cases import every
from support.live_fakes import PLANT
from support.live_views import resting_view, viewed


def test_the_status_says_what_matters_in_one_line() -> None:
    text = status_line(viewed(3000))
    assert "trusted" in text
    assert "3,000 samples" in text
    assert "a0 0.49" in text
    assert "+-" in text


def test_that_the_input_rests_is_said_once_beside_the_verdict() -> None:
    """The line shows no reasons, the screen does."""
    view = resting_view()
    assert "; trusted, not excited; " in status_line(view)
    assert "not excited" not in status_line(viewed(3000))
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(render(view))
    shown = console.export_text()
    assert " ".join(view.reasons[-1].split()[:5]) in " ".join(shown.split())
    assert "not excited" not in shown


HUGE = [1e300, -1e300, 1.7e308, 1e-300, np.nan, np.inf]


@every("value", HUGE)
def test_no_number_makes_a_line_long_whatever_its_size(value: float) -> None:
    """Each field of a view, all at once: a line of status stays a line, and the screen in its columns."""
    found = viewed(3000)
    many = {"stuck": 10**400, "lost": 2**64}
    view = dataclasses.replace(
        found, at=value, rate=value, lag=value, silence=value, simulated=value, dc_gain=value, dc_gain_std=value,
        parameters=np.full(2, value), std=np.full(2, value), samples=10**30, rejected=many, counters=many,
    )  # fmt: skip
    text = status_line(view)
    assert len(text) < 300
    assert not re.search(r"[\d,]{25}", text)
    for running in (True, False):
        console = Console(width=400, record=True, file=io.StringIO())
        console.print(render(view, rp.TransferFunction([1e-300], [1.0, 1e-300]), running=running))
        assert not re.search(r"[\d,]{25}", console.export_text())


@every("width", [80, 120])
@every("samples", [0, 3000])
def test_the_screen_keeps_within_its_width(width: int, samples: int) -> None:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(render(viewed(samples), PLANT))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= width
    assert ("off by" in text) == (samples > 0)


def test_a_terminal_that_has_gone_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after `| head`, or when the window is closed."""

    class Gone(io.StringIO):
        def write(self, _: str) -> int:
            raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("sys.stderr", Gone())
    status = TerminalStatus()
    for _ in range(2):
        status.show(viewed(300), ["replant: a line"])
    status.close()
