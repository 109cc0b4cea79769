"""Both ends of a wire: a source read by a thread, waiting without guessing times, and peers to read from."""

from __future__ import annotations

import socket
import threading

import numpy as np

from replant.live.streams import Batch, Source, open_source
from replant.live.streams.serial_and_network import UdpSource
from support.waiting import PATIENCE, wait_until


class Reading:
    """A source, read to its end by a thread."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.batches: list[Batch] = []
        self.ticks = 0
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            for batch in self.source.batches():
                if len(batch):
                    self.batches.append(batch)
                else:
                    self.ticks += 1
        except BaseException as error:
            self.error = error

    def __len__(self) -> int:
        return sum(len(batch) for batch in self.batches)

    def column(self, name: str) -> np.ndarray:
        return np.concatenate([getattr(batch, name) for batch in self.batches])

    def wait_for(self, samples: int) -> None:
        wait_until(lambda: len(self) >= samples or self.error is not None, f"{samples} samples came, {len(self)} did")
        assert self.error is None

    def wait_state(self, state: str) -> None:
        wait_until(lambda: self.source.state == state, f"the state is {state}")

    def wait_counted(self, reason: str, count: int) -> None:
        wait_until(lambda: self.source.counters.get(reason, 0) >= count, f"{reason} is {count}")

    def join(self) -> None:
        """Wait for the end of the stream."""
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "the source did not end"
        if self.error is not None:
            raise self.error

    def finish(self) -> None:
        self.source.close()
        self._thread.join(PATIENCE)

    def stop(self) -> None:
        self.source.close()
        self.join()


class Peer:
    """A TCP server for one connection at a time, on a port that the system chose."""

    def __init__(self, port: int = 0) -> None:
        self.listener = socket.create_server(("127.0.0.1", port))
        self.listener.settimeout(PATIENCE)
        self.port = self.listener.getsockname()[1]
        self.url = f"tcp://127.0.0.1:{self.port}"
        self.connection: socket.socket | None = None

    def accept(self) -> socket.socket:
        self.hang_up()
        self.connection, _ = self.listener.accept()
        self.connection.settimeout(PATIENCE)
        return self.connection

    def hang_up(self) -> None:
        if self.connection is not None:
            self.connection.close()
            self.connection = None

    def close(self) -> None:
        self.hang_up()
        self.listener.close()


def csv(*columns: np.ndarray) -> bytes:
    """Return lines of CSV with every digit."""
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "".join(",".join(map(repr, row)) + "\n" for row in rows).encode()


class Device:
    """A rig that sends to a source."""

    def __init__(self, source: UdpSource) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", source.port))

    def send(self, payload: bytes) -> None:
        self.socket.send(payload)

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()


def opened(options: str = "") -> UdpSource:
    """A source of datagrams at a free port."""
    source = open_source("udp://127.0.0.1:0" + options)
    assert isinstance(source, UdpSource)
    return source
