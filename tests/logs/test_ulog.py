"""ULog files, written message by message as PX4 does, and by pyulog."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.fitting.log_inspection import inspect
from replant.logs import read_columns, read_log

pyulog = pytest.importorskip("pyulog")

pytestmark = pytest.mark.usefixtures("read_here")
START = 10**12 + 7  # microseconds since the start of the system: float32 or differences of float64 would round
K = 40
U, Y = np.random.default_rng(0).standard_normal((2, K))


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def topic(number: int, name: str, rows: list[tuple[int, float, float]], instance: int = 0) -> bytes:
    """Return the data of a topic whose format is that of `save`: stamp in microseconds, control[2]."""
    added = message(b"A", struct.pack("<BH", instance, number) + name.encode())
    return added + b"".join(message(b"D", struct.pack("<HQ2f", number, START + t, a, b)) for t, a, b in rows)


def save(folder: Path, *topics: bytes, end: bytes = b"") -> Path:
    path = folder / "log.ulg"
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", START)
    formats = [message(b"F", f"{name}:uint64_t timestamp;float[2] control;".encode()) for name in ("drive", "motion")]
    path.write_bytes(head + message(b"B", bytes(40)) + b"".join([*formats, *topics]) + end)
    return path


def rows(values: np.ndarray, step: int) -> list[tuple[int, float, float]]:
    return [(step * k, float(np.float32(value)), 1.0) for k, value in enumerate(values)]


def test_topics_of_different_rates_are_merged(tmp_path: Path) -> None:
    path = save(tmp_path, topic(0, "drive", rows(U[:10], 4000)), topic(1, "motion", rows(Y, 1000)))
    names = ("drive.control[0]", "drive.control[1]", "motion.control[0]", "motion.control[1]")
    assert read_columns(path).names == names
    log = read_log(path, input="drive.control[0]", output="motion.control[0]")
    assert (log.dt, len(log)) == (0.001, K)
    assert log.time is not None
    assert log.time.tolist() == [k / 1000 for k in range(K)]
    np.testing.assert_array_equal(log.input, np.repeat(np.float32(U[:10]), 4))
    np.testing.assert_array_equal(log.output, np.float32(Y))


def test_a_stamp_within_a_message_is_not_its_clock(tmp_path: Path) -> None:
    """An example is position_setpoint_triplet.previous.timestamp, which stays zero."""
    formats = b"part:uint64_t timestamp;float x;", b"drive:uint64_t timestamp;part held;float u;float y;"
    samples = [struct.pack("<HQQ3f", 0, START + 1000 * k, 0, 0.0, U[k], Y[k]) for k in range(K)]
    added = [message(b"A", struct.pack("<BH", 0, 0) + b"drive"), *(message(b"D", each) for each in samples)]
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", START) + message(b"B", bytes(40))
    path = tmp_path / "log.ulg"
    path.write_bytes(head + b"".join([*(message(b"F", each) for each in formats), *added]))
    clock = inspect(path, input="drive.u", output="drive.y").clock
    assert clock is not None
    assert (clock.dt, clock.problem, clock.guess) == (0.001, "", "")


def test_instances_of_a_topic_are_numbered(tmp_path: Path) -> None:
    path = save(tmp_path, topic(0, "drive", rows(U, 1000)), topic(1, "drive", rows(Y, 1000), instance=1))
    log = read_log(path, input="drive[0].control[0]", output="drive[1].control[0]")
    np.testing.assert_array_equal(log.output, np.float32(Y))


def test_a_file_that_pyulog_wrote(tmp_path: Path) -> None:
    path = save(tmp_path, topic(0, "drive", rows(U, 4000)), topic(1, "motion", rows(Y, 4000)))
    pyulog.ULog(str(path)).write_ulog(str(tmp_path / "again.ulg"))
    again, first = read_columns(tmp_path / "again.ulg"), read_columns(path)
    assert sorted(again.names) == sorted(first.names)
    np.testing.assert_array_equal(again.column("motion.control[0]"), first.column("motion.control[0]"))


def test_lost_samples_are_noted(tmp_path: Path) -> None:
    topics = topic(0, "drive", rows(U, 1000)), message(b"O", struct.pack("<H", 250)), topic(1, "motion", rows(Y, 1000))
    with pytest.warns(UserWarning, match=r"log\.ulg: the logger lost samples for 0\.25 s, in 1 gaps"):
        read_log(save(tmp_path, *topics), input="drive.control[0]", output="motion.control[0]")


def test_a_file_without_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no channel of numbers with time stamps in the file"):
        read_columns(save(tmp_path))


def test_a_file_of_another_format_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.ulg").write_bytes(b"t,u,y\n0,1,2\n")
    with pytest.raises(LogError, match="not a readable ULog file"):
        read_columns(tmp_path / "log.ulg")
