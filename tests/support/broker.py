"""A real MQTT broker for the tests: Mosquitto on a port that the system chose; it can be killed and started again."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from pathlib import Path

from support.wires import PATIENCE, wait_until

#: Where Debian's package puts it, which is not on everybody's path.
PATHS = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"])
MOSQUITTO = shutil.which("mosquitto", path=PATHS)


class Broker:
    """Mosquitto, listening to this computer alone."""

    def __init__(self, folder: Path, *, settings: str = "allow_anonymous true\n") -> None:
        assert MOSQUITTO is not None
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port: int = free.getsockname()[1]
        self._settings = folder / "mosquitto.conf"
        self._settings.write_text(f"listener {self.port} 127.0.0.1\npersistence false\n{settings}")
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self) -> None:
        assert MOSQUITTO is not None
        silent = subprocess.DEVNULL
        self._process = subprocess.Popen([MOSQUITTO, "-c", str(self._settings)], stdout=silent, stderr=silent)
        wait_until(self._listens, "the broker listens")

    def kill(self) -> None:
        """End it as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _listens(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, "the broker ended: is its port taken?"
        try:
            socket.create_connection(("127.0.0.1", self.port), PATIENCE).close()
        except OSError:
            return False
        return True
