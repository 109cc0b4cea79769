"""The command as a person runs it: a process of its own, and what comes out of it."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import replant as rp
from replant.online import saving
from support.live_fakes import DT, REQUEST
from support.waiting import PATIENCE, wait_until

#: The command, with a long limit on the wait for the last view: the observer may still be starting then.
COMMAND = f"""
from replant.live import judge_client
judge_client.LAST_VIEW_TIMEOUT = {PATIENCE}
from replant.cli import main
main()
"""
wait_for = wait_until
MODEL = ("--poles", "1", "--dt", str(DT), "--startup", str(REQUEST.startup))


@contextmanager
def live(source: str, *options: object, model: tuple[str, ...] = MODEL) -> Iterator[subprocess.Popen[bytes]]:
    """Run ``replant live``; killed at the end of the block if it still runs."""
    command = [sys.executable, "-W", "error", "-c", COMMAND, "live", source, *model, *map(str, options)]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=dict(os.environ)
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def finished(process: subprocess.Popen[bytes], data: bytes | None = None) -> tuple[int, str, str]:
    """Exit code, standard output and error of a process that ends by itself."""
    out, err = process.communicate(data, timeout=PATIENCE)
    return process.returncode, out.decode(), err.decode()


def lines(u: np.ndarray, y: np.ndarray, t: np.ndarray | None = None, first: int | None = None) -> list[bytes]:
    """CSV lines of samples, exact, with stamps and numbers from ``first`` on where they are given."""
    columns = [] if first is None else [range(first, first + u.size)]
    columns += [] if t is None else [t.tolist()]
    return [(",".join(map(repr, row)) + "\n").encode() for row in zip(*columns, u.tolist(), y.tolist(), strict=True)]


def learned(u: np.ndarray, y: np.ndarray, t: np.ndarray | None = None) -> rp.Identifier:
    """An identifier that took a record at once."""
    identifier = rp.Identifier(**vars(REQUEST))
    identifier.update_many(u, y, t)
    return identifier


def estimates(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def sequence_of(path: Path) -> int:
    """The number of the last sample in a checkpoint; -1 where there is none yet."""
    try:
        return int(saving.load(path).progress.get("sequence", -1))
    except checkpoint_errors():
        return -1


def checkpoint_errors() -> type[Exception]:
    from replant.errors import CheckpointError

    return CheckpointError


class ReplayingPeer:
    """A TCP peer that sends numbered lines a block at a time: those before ``until``, which may be moved on.

    Where ``resumed`` says so, a client tells first where it goes on.
    """

    def __init__(self, lines: list[bytes], block: int = 50, pause: float = 0.0) -> None:
        self._lines, self._block, self._pause = lines, block, pause
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp://127.0.0.1:{self._listening.getsockname()[1]}?columns=n,t,u,y"
        self.until, self.resumed = len(lines), False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            with client:
                try:
                    self._send(client)
                    client.recv(1)  # until it goes
                except OSError:
                    continue

    def _send(self, client: socket.socket) -> None:
        client.settimeout(PATIENCE)
        at = int(client.makefile().readline().split()[1]) + 1 if self.resumed else 0
        while at < len(self._lines):
            end = min(at + self._block, self.until)
            client.sendall(b"".join(self._lines[at:end]))
            at = end
            time.sleep(self._pause)

    def close(self) -> None:
        self._listening.close()
