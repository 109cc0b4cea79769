"""A workbench being served, its sessions in a folder of the test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import replant as rp
from support.browsing import chromium


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """The system's Chromium; not for longer than a module: its loop would stand in the way of others."""
    with chromium() as launched:
        yield launched


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of sessions, and a working folder without logs."""
    folder, work = tmp_path / "state", tmp_path / "work"
    work.mkdir()
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    monkeypatch.chdir(work)
    return folder / "replant"


@pytest.fixture
def motor(tmp_path: Path) -> Path:
    """A log of a motor, with names that tell no role, and another column."""
    log = rp.examples.motor()
    signals = zip(log.input.tolist(), log.output.tolist(), strict=True)
    rows = (f"{0.02 * k:.2f},{u},{y},{k % 7}\n" for k, (u, y) in enumerate(signals))
    path = tmp_path / "motor.csv"
    path.write_text("t,a,b,pump\n" + "".join(rows))
    return path
