"""The line that shows how far a command is."""

from __future__ import annotations

import io
import re

import pytest

from replant.cli import progress
from replant.cli.progress import Bar, Lines, Progress, progress_bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def drawn(stream: io.StringIO) -> list[str]:
    return [re.sub(r"\x1b\[[\d;]*m", "", line) for line in re.split(r"\x1b\[1A\r\x1b\[J", stream.getvalue())]


def test_a_bar_grows_with_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 0.0, 10.0, 10.01, 20.0, 30.0, 45.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    monkeypatch.setattr("sys.stderr", stream := Terminal())
    monkeypatch.setenv("COLUMNS", "80")
    with Bar(rate=True) as bar:
        bar.show("planning")
        bar.show("identifying", 1000.0, 4000.0)
        bar.show("identifying", 1001.0, 4000.0)  # too soon to be seen
        bar.show("identifying", 2000.0, 4000.0)
        bar.show("once more", 0.0, 4000.0)
        bar.show("once more", 1500.0, 4000.0)
    lines = drawn(stream)
    assert all(len(line.rstrip()) < 80 for line in lines)
    assert [re.findall(r"\d+%.*", line) for line in lines] == [
        [], ["25% 100 samples/s 0:00:30 left"], ["50% 100 samples/s 0:00:20 left"], ["0%"],
        ["38% 100 samples/s 0:00:25 left"], [],
    ]  # fmt: skip
    assert lines[-1] == ""


def test_without_a_terminal_nothing_is_shown_unless_asked_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with progress_bar() as bar:
        bar.show("identifying", 1.0, 2.0)
    assert (type(bar), capsys.readouterr().err) == (Progress, "")
    with Lines() as lines:
        for done in range(1, 101):
            lines.show(f"rig {done}", done, 100.0, stage="rigs")
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 11
    assert said[-1] == "replant: rig 100 100 %"
    monkeypatch.setattr("sys.stderr", Terminal())
    assert isinstance(progress_bar(), Bar)
