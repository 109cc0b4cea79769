"""Serial ports, on a pair of pseudo-terminals: bulk reads, half lines at the start, the cable out and in again."""

from __future__ import annotations

import builtins
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from replant.errors import InvalidArgumentError, LogError, MissingDependencyError
from replant.live.streams import Signals, open_source, serial_and_network
from support.boards import Board
from support.cases import every
from support.wires import Reading, csv, wait_until

pytest.importorskip("serial", reason="pyserial is not installed")
pytest.importorskip("pty", reason="this system has no pseudo-terminals")


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    board = Board(tmp_path / "ttyUSB0")
    yield board
    if board.device.is_symlink():
        board.pull_out()


def test_lines_to_the_bit_after_the_first_whose_beginning_was_missed(
    board: Board, read: Callable[..., Reading]
) -> None:
    t, u, y = np.random.default_rng(9).normal(size=(3, 3000))
    reading = read(open_source(board.url))
    board.send(b"\r\n" + csv(t, u, y).replace(b"\n", b"\r\n"))
    reading.wait_for(3000)
    reading.stop()
    for name, expected in (("t", t), ("u", u), ("y", y)):
        assert np.array_equal(reading.column(name), expected)
    assert reading.source.counters == {}


def test_what_comes_before_the_first_end_of_a_line_is_cut_off(board: Board, read: Callable[..., Reading]) -> None:
    reading = read(open_source(board.url))
    board.send(b"9.5,1\n")
    reading.wait_counted("cut off", 1)
    board.send(b"1,2\n3,4\n")
    reading.wait_for(2)
    reading.stop()
    assert reading.column("u").tolist() == [1.0, 3.0]
    assert reading.source.counters == {"cut off": 1}


def test_the_cable_out_and_in_again(board: Board, read: Callable[..., Reading]) -> None:
    """The board was reset and counts from zero: that is no repetition."""
    reading = read(open_source(board.url))
    board.send(b"\n500,0.1,1,2\n501,0.2,1,2\n502,0.3,")
    reading.wait_for(2)
    board.pull_out()
    reading.wait_state("waiting")
    assert getattr(reading.source, "trouble", "")
    board.plug_in()
    reading.wait_state("connected")
    board.send(b"9,9\n0,0.0,1,3\n1,0.1,1,3\n")
    reading.wait_for(4)
    reading.stop()
    assert reading.column("sequence").tolist() == [500, 501, 0, 1]
    assert reading.source.counters == {"reconnects": 1, "cut off": 2}


def test_noise_on_the_line(board: Board, read: Callable[..., Reading]) -> None:
    reading = read(open_source(board.url))
    board.send(b"\n1,2\n2,3\n" + bytes(range(128, 256)) + b"\nbrownout\n3,4\n")
    reading.wait_for(3)
    reading.stop()
    assert reading.source.counters == {"not a number": 2}


def test_a_header_without_the_names_that_were_given_ends_the_session(
    board: Board, read: Callable[..., Reading]
) -> None:
    reading = read(open_source(board.url, Signals(("voltage",), "speed")))
    board.send(b"\nspeed,volt\n1,2\n3,4\n")
    with pytest.raises(LogError, match="no column 'voltage' in the header"):
        reading.join()


def test_seek_does_not_stop_a_board_that_counts_from_zero(board: Board, read: Callable[..., Reading]) -> None:
    source = open_source(board.url)
    source.seek(10**6)
    reading = read(source)
    board.send(b"\n0,0.0,1,2\n1,0.1,1,2\n")
    reading.wait_for(2)


def test_close_while_the_board_keeps_silent(board: Board, read: Callable[..., Reading]) -> None:
    reading = read(open_source(board.url))
    reading.wait_state("connected")
    wait_until(lambda: reading.ticks > 0, "it ticked")
    reading.stop()


def test_closing_what_was_never_read(board: Board) -> None:
    source = open_source(board.url)
    source.close()
    assert not list(filter(len, source.batches()))


def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"No such file or directory.*ports found: .*dialout") as caught:
        open_source(f"serial://{tmp_path}/ttyUSB9")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("url", "package"), [("serial:///dev/ttyUSB0", "pyserial"), ("mqtt://127.0.0.1/rig", "paho-mqtt")]
)
def test_a_missing_package_names_its_extra(monkeypatch: pytest.MonkeyPatch, url: str, package: str) -> None:
    really = builtins.__import__

    def without(name: str, *rest: object) -> object:
        if name.partition(".")[0] in {"serial", "paho"}:
            raise ImportError(name)
        return really(name, *rest)

    for name in [name for name in sys.modules if name.partition(".")[0] in {"serial", "paho"}]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingDependencyError, match=rf"{package}: pip install 'replant\[live\]'$"):
        open_source(url)


@every(("ports", "words"), [((), "ports found: none;"), (("ttyB", "ttyA"), "ports found: ttyA, ttyB;")])
def test_the_ports_that_exist_are_named(monkeypatch: pytest.MonkeyPatch, ports: tuple[str, ...], words: str) -> None:
    found = [SimpleNamespace(device=name) for name in ports]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    assert words in serial_and_network.remedy("ttyUSB7")
