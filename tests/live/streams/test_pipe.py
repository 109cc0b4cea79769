"""Standard input: lines of a program before us in the pipe."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from replant.live.streams.addresses import Address
from replant.live.streams.serial_and_network import PipeSource
from support.wires import Reading, csv

PROGRAM = """
import sys
from replant.live.streams import open_source
source = open_source("-")
for batch in source.batches():
    for n, u, y in zip(batch.t if len(batch) else (), batch.u, batch.y):
        print(n.hex(), u.hex(), y.hex())
print(source.counters, source.state)
"""


def test_lines_until_the_pipe_ends(read: Callable[..., Reading]) -> None:
    """The last one counts without its end."""
    t, u, y = np.random.default_rng(8).normal(size=(3, 20_000))
    out, into = os.pipe()
    reading = read(PipeSource(Address("-", ""), file=out))
    with os.fdopen(into, "wb") as writer:
        writer.write(b"t,u,y\n" + csv(t, u, y).rstrip(b"\n"))
    reading.join()
    os.close(out)
    assert np.array_equal(reading.column("t"), t)
    assert np.array_equal(reading.column("y"), y)
    assert reading.source.counters == {}
    assert reading.source.state == "ended"


def test_close_while_the_writer_keeps_silent(read: Callable[..., Reading]) -> None:
    out, into = os.pipe()
    reading = read(PipeSource(Address("-", ""), file=out))
    os.write(into, b"1,2\n3,4\n5,")
    reading.wait_for(2)
    reading.stop()
    os.close(into)
    os.close(out)
    assert len(reading) == 2


def test_standard_input_may_be_a_pipe_or_a_file(tmp_path: Path) -> None:
    file = tmp_path / "samples.csv"
    file.write_bytes(b"0.1,1,2\n0.2,3,0.1\n")
    expected = [f"{(0.1).hex()} {(1.0).hex()} {(2.0).hex()}", f"{(0.2).hex()} {(3.0).hex()} {(0.1).hex()}", "{} ended"]
    run = [sys.executable, "-W", "error", "-c", PROGRAM]
    piped = subprocess.run(run, input=file.read_bytes(), capture_output=True, check=True).stdout.decode()
    with file.open("rb") as opened:
        redirected = subprocess.run(run, stdin=opened, capture_output=True, check=True).stdout.decode()
    assert piped.splitlines() == redirected.splitlines() == expected
