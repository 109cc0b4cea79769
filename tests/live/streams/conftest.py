"""What the tests of sources share."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from replant.live.streams import Source, reader_thread
from support.waiting import PATIENCE
from support.wires import Peer, Reading


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have sources wait for their threads, as long as it takes on a busy machine."""
    monkeypatch.setattr(reader_thread, "CLOSE_TIMEOUT", PATIENCE)


@pytest.fixture
def read() -> Iterator[Callable[[Source], Reading]]:
    """Read a source in the background; whatever happens it is closed."""
    readings: list[Reading] = []

    def start(source: Source) -> Reading:
        readings.append(Reading(source))
        return readings[-1]

    yield start
    for reading in readings:
        reading.source.close()
    for reading in readings:
        reading.finish()


@pytest.fixture
def peer() -> Iterator[Peer]:
    server = Peer()
    yield server
    server.close()
