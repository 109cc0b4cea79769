"""`replant open` as a command: it says where it is, serves until Ctrl-C, and ends."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from replant.errors import InvalidArgumentError
from replant.workbench import session
from replant.workbench.app import opened
from support.command import call
from support.http_request import ask
from support.waiting import PATIENCE


@pytest.mark.slow
def test_it_serves_until_ctrl_c_and_takes_the_next_port_where_one_is_in_use(motor: Path) -> None:
    command = [sys.executable, "-m", "replant", "open", str(motor), "--at", "127.0.0.1:0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as first:
        assert first.stderr is not None
        port = int(re.search(r":(\d+)/", first.stderr.readline())[1])
        again = [*command[:-1], f"127.0.0.1:{port}"]
        with subprocess.Popen(again, stderr=subprocess.PIPE, text=True) as second:
            assert second.stderr is not None
            other = int(re.search(r":(\d+)/", second.stderr.readline())[1])
            assert other != port
            assert ask(other, "GET /", f"Authorization: Bearer {session.token()}")[0] == 200
            second.send_signal(signal.SIGTERM)
            assert second.wait(PATIENCE) == 0
        first.send_signal(signal.SIGINT)
        assert first.wait(PATIENCE) == 0
        assert "Traceback" not in first.stderr.read()


def test_the_next_free_port_is_taken_whatever_uses_the_wanted_one() -> None:
    while True:
        with socket.create_server(("127.0.0.1", 0)) as taken, contextlib.ExitStack() as held:
            port = taken.getsockname()[1]
            try:
                held.enter_context(socket.create_server(("127.0.0.1", port + 1)))
                socket.create_server(("127.0.0.1", port + 2)).close()
            except (OSError, OverflowError):  # in use, or beyond the last port
                continue
            with opened([], port=port) as served:
                assert served.port == port + 2
            return


def test_the_last_port_in_use_is_named_as_it_was_asked_for() -> None:
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):  # in use by another program
            held.enter_context(socket.create_server(("127.0.0.1", 65535)))
        with pytest.raises(InvalidArgumentError, match=r"^port 65535 of 127\.0\.0\.1 is in use, and so is each above"):
            held.enter_context(opened([], port=65535))
    with pytest.raises(InvalidArgumentError, match="got 65536"), opened([], port=65536):
        pass


def test_a_mistake_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damaged = tmp_path / "a.workbench"
    damaged.write_text("{}")
    command = [sys.executable, "-m", "replant", "open", "no.csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    told = [(done.returncode, done.stdout, done.stderr)]
    told += [call(capsys, "open", *words) for words in ([damaged], [damaged, damaged], ["--at", "nowhere"])]
    for code, _, err in told:
        assert code == 2
        assert err.startswith("replant: ")
        assert err.count("\n") == 1
