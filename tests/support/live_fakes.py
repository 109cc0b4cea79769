"""Stand-ins for what surrounds a session, and the record that they play."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import replant as rp
from replant.estimation.settings import Request
from replant.live.outputs.message import DiskWriter, EstimateMessage, Notices
from replant.live.progress import CheckpointWriter
from replant.live.session import Session
from replant.live.streams import Batch, Source
from replant.live.view import SessionInfo
from support.waiting import PATIENCE

PLANT, DT = rp.TransferFunction([2.0], [1.0, 0.5]), 0.05
REQUEST = Request(rp.Structure(1), DT, preprocess=rp.Preprocess("identity", "mean", "mean"), startup=200)


def record(samples: int = 3000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Input and noisy output of `PLANT` around a working point."""
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.choice([-1.0, 1.0], -(-samples // 10)), 10)[:samples]
    return 3.0 + u, 7.0 + PLANT.simulate(u, DT) + 0.02 * generator.standard_normal(samples)


class FakeSource:
    """Batches of random sizes, numbered from ``first``; goes on after a number as a peer that can replay."""

    name, state, trouble, refused, remark = "fake://", "connected", "", "", ""

    def __init__(
        self, u: np.ndarray, y: np.ndarray, *, numbered: bool = True, t: np.ndarray | None = None, seed: int = 1,
        between: Callable[[int], None] = lambda done: None, endless: bool = False, r: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        self.counters: dict[str, int] = {}
        self._u, self._y, self._t, self._r, self._numbered = u, y, t, r, numbered
        self._at, self._closed, self._between, self._endless = 0, False, between, endless
        self._generator = np.random.default_rng(seed)

    def seek(self, sequence: int) -> None:
        self._at = sequence + 1

    def close(self) -> None:
        self._closed = True

    def batches(self) -> Iterator[Batch]:
        while self._at < len(self._u) and not self._closed:
            end = min(self._at + int(self._generator.integers(0, 50)), len(self._u))
            part = slice(self._at, end)
            self._at = end
            yield Batch(
                self._u[part], self._y[part], None if self._t is None else self._t[part],
                np.arange(part.start, end) if self._numbered else None, time.monotonic(),
                None if self._r is None else self._r[part],
            )  # fmt: skip
            self._between(end)
        while self._endless and not self._closed:
            time.sleep(0.01)
            yield Batch(np.zeros(0), np.zeros(0), None, None, time.monotonic())


class FakeObserver:
    """Never has a view, unless it is given one; remembers what was shown and handed."""

    url = ""

    def __init__(self, view: Any = None, commands: tuple[str, ...] = ()) -> None:
        self.view = self.last = view
        self.shown: list[str] = []
        self.infos: list[SessionInfo] = []
        self._commands = list(commands)

    def show(self, line: str) -> None:
        self.shown.append(line)

    def poll(self) -> list[str]:
        commands, self._commands = self._commands, []
        return commands

    def ask(self, name: str) -> None:
        self._commands.append(name)

    def hand_over(self, identifier: rp.Identifier, info: SessionInfo, *, learned: bool) -> bool:
        self.infos.append(info)
        return True

    def wait_for_view(self, identifier: rp.Identifier, info: SessionInfo) -> None:
        self.infos.append(info)


class FakeSink:
    name, interval, behind = "fake sink", 0.0, False

    def __init__(self, failure: Exception | None = None) -> None:
        self.sent: list[EstimateMessage] = []
        self.closed, self._failure = False, failure

    def send(self, estimate: EstimateMessage) -> None:
        if self._failure is not None:
            raise self._failure
        self.sent.append(estimate)

    def close(self) -> None:
        self.closed = True


class JudgingObserver(FakeObserver):
    """Has a verdict on every state that it is handed, at once: what a real one finds, without its delay."""

    def hand_over(self, identifier: rp.Identifier, info: SessionInfo, *, learned: bool) -> bool:
        if learned or self.view is None:  # else it is the state that it was
            assessment = identifier.assess()
            self.view = self.last = SimpleNamespace(
                verdict=assessment.status,
                excited=assessment.excited,
                coefficients=False,
                parameters=identifier.parameters,
                std=identifier.uncertainty.std,
            )
        return super().hand_over(identifier, info, learned=learned)


def make(
    source: Source, *, observer: FakeObserver | None = None, path: Path | None = None, every: float = 1e-9,
    identifier: rp.Identifier | None = None, ttl: float = PATIENCE, **arguments: Any,
) -> tuple[Session, FakeObserver]:  # fmt: skip
    """Return a session and its observer; trust does not expire on a machine that is busy."""
    observer = observer or FakeObserver()
    notices = Notices(observer.show)
    disk_writer = DiskWriter(notices)
    checkpoints = None if path is None else CheckpointWriter(path, every, disk_writer)
    session = Session(
        source=source, identifier=identifier or rp.Identifier(**vars(REQUEST)), disk_writer=disk_writer,
        notices=notices, observer=observer, checkpoints=checkpoints, ttl=ttl, **arguments,
    )  # fmt: skip
    return session, observer
