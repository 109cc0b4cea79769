"""The status at the terminal: short, within its columns, and silent after the terminal was closed."""

from __future__ import annotations

import dataclasses
import io
import re

import numpy as np
import pytest
from rich.console import Console

import replant as rp
from replant.live import terminal_status
from replant.live.terminal_status import TerminalStatus, render, status_line
from replant.plotting.numbers import wrapped
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


@every("width", [60, 80, 120])
@every("samples", [0, 3000])
def test_the_screen_keeps_within_its_width(width: int, samples: int) -> None:
    console = Console(width=width, record=True, file=io.StringIO())
    view = viewed(samples)
    console.print(render(view, PLANT))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= width
    assert ("off by" in text) == (samples > 0)
    reason = "\n".join(" " * 9 + line for line in wrapped(view.reasons[-1], width - 9))
    assert reason in "\n".join(map(str.rstrip, text.splitlines()))


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


SCREEN = """\
tcp://rig  waiting
123.4 s   3,000 samples   20/s   12.5 ms behind   2 outlier, 1 lost

          2
G(s) = -------
       s + 0.5

coefficient  estimate   std  true   off by
         a0      0.51  0.01   0.5  +2.00 %
         b0         2  0.04     2     +0 %

DC gain  4.000 +- 0.050    Fit  98.8 % from the input alone, newest samples
Verdict  ● trusted
         one reason, which goes on which goes on which goes on which goes on
         which goes on which goes on
         another
Ctrl-C ends
"""


@every("running", [True, False])
@every("truth", [PLANT, None])
def test_the_screen_shows_a_view_line_by_line(truth: rp.TransferFunction | None, running: bool) -> None:
    view = dataclasses.replace(
        viewed(3000), at=123.4, rate=20.0, lag=0.0125, source="tcp://rig", source_state="waiting",
        rejected={"outlier": 2, "stuck": 0}, counters={"lost": 1}, verdict="trusted", delay=0.0,
        reasons=("one reason," + 6 * " which goes on", "another"), num=np.array([2.0]), den=np.array([1.0, 0.5]),
        names=("a0", "b0"), parameters=np.array([0.51, 2.0]), std=np.array([0.01, 0.04]), dc_gain=4.0, dc_gain_std=0.05,
        simulated=98.76,
    )  # fmt: skip
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(render(view, truth, running=running))
    expected = SCREEN
    if not running:  # at the end there is no rate, and nothing to end
        expected = expected.replace("   20/s   12.5 ms behind", "").replace("Ctrl-C ends\n", "")
    if truth is None:
        expected = expected.replace("  true   off by", "").replace("   0.5  +2.00 %", "").replace("     2     +0 %", "")
    assert [line.rstrip() for line in console.export_text().splitlines()] == expected.splitlines()


def test_where_nobody_watches_a_line_comes_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now, view = [100.0], viewed(300)
    monkeypatch.setattr(terminal_status.time, "monotonic", lambda: now[0])
    status = TerminalStatus()
    for at, said in (
        (100.0, 1),
        (100.0 + terminal_status.LINES_APART - 0.1, 0),
        (100.0 + terminal_status.LINES_APART, 1),
    ):
        now[0] = at
        status.show(view, ["replant: a line"])
        assert capsys.readouterr().err.splitlines() == ["replant: a line"] + said * [status_line(view)]
    status.show(None, ["replant: another"])
    assert capsys.readouterr().err == "replant: another\n"
    status.close()
