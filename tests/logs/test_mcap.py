"""MCAP files and ROS 2 bags of them, as the writers of mcap make them."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.errors import LogError, MissingDependencyError
from replant.logs import read_columns, read_log

pytest.importorskip("mcap_ros2")
from mcap.writer import Writer
from mcap_ros2.writer import Writer as RosWriter

pytestmark = pytest.mark.usefixtures("read_here")

K = 40
START = 1_714_557_600_000_000_123  # nanoseconds since 1970, which a float64 rounds to 256
U, Y = np.random.default_rng(0).standard_normal((2, K))
STATE = """std_msgs/Header header
string[] name
float64[] position
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def save_ros(path: Path, rows: range = range(K)) -> Path:
    """Write commands every 4 ms, and joint states every 1 ms."""
    with path.open("wb") as file:
        writer = RosWriter(file)
        command = writer.register_msgdef("std_msgs/msg/Float64", "float64 data")
        state = writer.register_msgdef("sensor_msgs/msg/JointState", STATE)
        for k in rows:
            at = START + 1_000_000 * k
            if k % 4 == 0:
                writer.write_message("/drive", command, {"data": U[k // 4]}, at, at)
            header = {"stamp": {"sec": 5, "nanosec": k}, "frame_id": "base"}
            message = {"header": header, "name": ["a", "b"], "position": [Y[k], 1.0]}
            writer.write_message("/joints", state, message, at, at)
        writer.finish()
    return path


def save_json(path: Path, *messages: tuple[str, int, Any], encoding: str = "json") -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, at, content in messages:
            if topic not in channels:
                schema = writer.register_schema(topic, "jsonschema", b"{}")
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], START + at, json.dumps(content).encode(), START + at)
        writer.finish()
    return path


def test_topics_of_ros_2_are_merged(tmp_path: Path) -> None:
    path = save_ros(tmp_path / "log.mcap")
    names = ("/drive.data", "/joints.header.stamp.sec", "/joints.header.stamp.nanosec")
    assert read_columns(path).names == (*names, "/joints.position[0]", "/joints.position[1]")
    log = read_log(path, input="/drive.data", output="/joints.position[0]")
    assert (log.dt, len(log)) == (0.001, K)
    assert log.time is not None
    assert log.time.tolist() == [k / 1000 for k in range(K)]
    np.testing.assert_array_equal(log.input, np.repeat(U[:10], 4))
    np.testing.assert_array_equal(log.output, Y)


def test_a_bag_is_a_folder_of_parts(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    save_ros(bag / "bag_2.mcap", range(20))
    save_ros(bag / "bag_10.mcap", range(20, K))
    (bag / "metadata.yaml").touch()
    log = read_log(bag, input="/drive.data", output="/joints.position[0]")
    np.testing.assert_array_equal(log.output, Y)


def test_a_bag_in_sqlite_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "bag_0.db3").touch()
    with pytest.raises(LogError, match="a ROS 2 bag in SQLite; write it as MCAP with: ros2 bag convert"):
        read_columns(tmp_path)


def test_messages_of_json_are_read(tmp_path: Path) -> None:
    rows = [("/rig", 10_000_000 * k, {"u": U[k], "arm": {"y": Y[k], "on": True}, "s": "RUN"}) for k in range(K)]
    path = save_json(tmp_path / "log.mcap", *rows)
    assert read_columns(path).names == ("/rig.u", "/rig.arm.y", "/rig.arm.on")
    log = read_log(path, input="/rig.u", output="/rig.arm.y")
    assert log.dt == 0.01
    np.testing.assert_array_equal(log.output, Y)


def test_what_a_later_message_lacks_is_missing(tmp_path: Path) -> None:
    rows = [("/rig", 0, {"u": 1, "y": [1, 2]}), ("/rig", 1, {"u": None, "y": [3]}), ("/rig", 2, {"y": "x"})]
    u, y = read_columns(save_json(tmp_path / "log.mcap", *rows)).columns(["/rig.u", "/rig.y[1]"])
    np.testing.assert_array_equal(u, [1.0, np.nan, np.nan])
    np.testing.assert_array_equal(y, [2.0, np.nan, np.nan])


def test_messages_that_cannot_be_decoded(tmp_path: Path) -> None:
    path = save_json(tmp_path / "log.mcap", ("/rig", 0, {"u": 1}), encoding="protobuf")
    with pytest.raises(LogError, match=r"no message of ROS 2 or JSON in the file \(protobuf\); choose another file"):
        read_columns(path)


def test_a_file_that_was_cut_off_is_to_be_recovered(tmp_path: Path) -> None:
    path = save_ros(tmp_path / "log.mcap")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(LogError, match=r"not a readable MCAP file .*; repair it with: mcap recover"):
        read_columns(path)


def test_without_mcap_the_message_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = shutil.copy(save_ros(tmp_path / "log.mcap"), tmp_path / "copy.mcap")
    monkeypatch.setitem(sys.modules, "mcap_ros2", None)
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)
    with pytest.raises(MissingDependencyError, match=re.escape("reading MCAP needs mcap: pip install 'replant[mcap]'")):
        read_columns(path)
