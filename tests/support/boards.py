"""A microcontroller at a serial port, which is a pseudo-terminal."""

from __future__ import annotations

import os
from pathlib import Path


class Board:
    """A microcontroller at the other end of a cable, whose device file is a link that outlives it."""

    def __init__(self, device: Path) -> None:
        self.device = device
        self.plug_in()

    def plug_in(self) -> None:
        import pty
        import tty

        self.end, port = pty.openpty()
        tty.setraw(port)
        self.port = port
        self.device.symlink_to(os.ttyname(port))

    def pull_out(self) -> None:
        self.device.unlink()
        os.close(self.port)
        os.close(self.end)

    def send(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(self.end, rest[:1024]) :]

    @property
    def url(self) -> str:
        return f"serial://{self.device}?baud=115200"
