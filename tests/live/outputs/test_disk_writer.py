"""The thread that writes to disk: failures and a slow disk are reported."""

from __future__ import annotations

import threading
from pathlib import Path

from replant.live.outputs.message import DiskWriter, Notices


def test_a_job_that_fails_is_said_and_the_next_is_done(tmp_path: Path) -> None:
    said: list[str] = []
    disk_writer = DiskWriter(Notices(said.append))
    done = []

    def fail() -> None:
        raise OSError(28, "No space left on device", "rig")

    assert disk_writer.submit("checkpoint", fail)
    assert disk_writer.submit("checkpoint", lambda: done.append(1))
    disk_writer.close()
    assert said == ["replant: checkpoint: No space left on device: 'rig'; identification continues"]
    assert done == [1]


def test_a_disk_that_does_not_keep_up_is_said() -> None:
    said: list[str] = []
    disk_writer = DiskWriter(Notices(said.append))
    held = threading.Event()
    taken = [disk_writer.submit("record", held.wait) for _ in range(30)]
    held.set()
    disk_writer.close()
    assert not all(taken)
    assert said == ["replant: record: the disk is too slow; a part is left out"]
