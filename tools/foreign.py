"""A wheel for another processor, tried under QEMU's user mode: `tools/wheels.py` says what is run.

The Python is that of Debian for the processor, fetched by apt into a folder of its own and unpacked there, so that
nothing of this system changes; what the wheel needs comes from the package index.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

PROCESSORS = {"aarch64": "arm64"}
"""Processors that are tried, with Debian's names for them."""

PACKAGES = ("python3-minimal", "libpython3-stdlib", "libstdc++6")
"""What Python and the libraries of NumPy and SciPy need, of Debian."""

LIBC = range(17, 37)
"""Minor versions of glibc 2 whose wheels are taken [number].
Derivation: from that of the wheel to that of Debian 12, the oldest whose Python is new enough.
"""


class UntriedError(Exception):
    """The wheel cannot be tried here; the message says why."""


def try_out(wheel: Path, processor: str, script: str, folder: Path, constraints: Path) -> str:
    """Install a wheel and what it needs into a folder, run a script with it, and return what that prints.

    Raises
    ------
    UntriedError
        The processor cannot be had here.
    subprocess.CalledProcessError
        The wheel cannot be installed, or the script fails.
    """
    emulator = _found([f"qemu-{processor}-static", f"qemu-{processor}"], "apt install qemu-user-static")
    root = folder / "root"
    _unpack(_fetch(PROCESSORS[processor], folder / "apt"), root)
    python = max((root / "usr/bin").glob("python3.*[0-9]"), key=lambda path: int(path.name.partition(".")[2]))
    site = folder / "site"
    platforms = [f"--platform=manylinux_2_{minor}_{processor}" for minor in LIBC]
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--constraint",
        constraints,
    ]
    version = python.name.removeprefix("python")
    only = ["--only-binary=:all:", "--implementation=cp", f"--python-version={version}", *platforms]
    subprocess.run([*pip, "--target", site, *only, wheel], check=True)
    own = {**os.environ, "PYTHONPATH": str(site), "OPENBLAS_NUM_THREADS": "1"}
    command = [emulator, "-L", root, python, "-c", script]
    return subprocess.run(command, cwd=folder, env=own, check=True, capture_output=True, text=True).stdout


def _found(names: Iterable[str], advice: str) -> str:
    """Return the first of these programs that there is."""
    found = [path for path in map(shutil.which, names) if path]
    if not found:
        raise UntriedError(f"there is no {' or '.join(names)}: {advice}")
    return found[0]


def _fetch(architecture: str, folder: Path) -> list[Path]:
    """Return the packages of Python for another architecture, and all that they need."""
    apt = _found(["apt-get"], "its Python comes from Debian")
    for name in ("lists/partial", "cache/archives/partial"):
        (folder / name).mkdir(parents=True)
    (folder / "status").touch()
    own = {
        "APT::Architecture": architecture, "APT::Architectures": architecture, "APT::Sandbox::User": "",
        "Dir::State::Lists": folder / "lists", "Dir::State::Status": folder / "status", "Dir::Cache": folder / "cache",
        "Debug::NoLocking": "1",
    }  # fmt: skip
    settings = [f"--option={name}={value}" for name, value in own.items()]
    install = ["install", "--yes", "--download-only", "--no-install-recommends", *PACKAGES]
    for command in (["update"], install):
        done = subprocess.run([apt, "-qq", *settings, *command], capture_output=True, text=True, check=False)
        if done.returncode:
            said = done.stderr.strip().splitlines() or ["no reason given"]
            raise UntriedError(f"apt-get {command[0]} for {architecture} fails: {said[-1]}")
    return sorted(folder.glob("cache/archives/*.deb"))


def _unpack(packages: list[Path], root: Path) -> None:
    dpkg = _found(["dpkg"], "its Python comes from Debian")
    for package in packages:
        subprocess.run([dpkg, "-x", package, root], check=True)
