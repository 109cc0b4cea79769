"""The build hook: compiles the kernels, and puts uPlot, which draws the plots over time, into the package.

The kernels' library is made by tools/translator with the C compiler found, else with that of the package ziglang, which
is asked for only then.  ``REPLANT_WHEEL=aarch64-linux-gnu.2.17:manylinux_2_17_aarch64`` makes the wheel of another
system: its name as zig has it, and the wheel's tag.  An editable installation gets the library beside its sources.

uPlot (MIT) is no part of the repository.  Its npm package is fetched with npm when replant is installed or built, its
files are compared with the sums below, and lie in a folder that git ignores, where an editable installation finds them
as well.  A source distribution carries them, so that nothing is fetched to install from one.

Without npm, or without a network, the build says so and goes on: all but the report and the dashboard works, and these
then say what to do.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "uplot@1.6.32"
#: Where each file is in the npm package, and its SHA-256.
FILES = {
    "package/dist/uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "package/dist/uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "package/LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}
FOLDER = "src/replant/report/assets/uplot"
LONGEST = 120  # s that npm may take
SUFFIXES = {"darwin": "dylib", "macos": "dylib", "win": "dll"}  # of a library, by the name of a system


class UPlotHook(BuildHookInterface):  # type: ignore[type-arg]
    """Fetches uPlot before anything is built."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Have uPlot's files where `artifacts` in pyproject.toml names them."""
        try:
            provide(Path(self.root, FOLDER))
        except OSError as reason:
            self.app.display_warning(f"uPlot is left out: {reason}. The report and the dashboard need it.")


class PackageHook(UPlotHook):
    """Compiles the kernels as well, for a wheel or an editable installation."""

    _folder: tempfile.TemporaryDirectory[str] | None = None  # of the library for a wheel

    def dependencies(self) -> list[str]:
        """Return what the build needs beside what pyproject.toml says: a compiler, where there is none."""
        own = "REPLANT_WHEEL" not in os.environ and (os.environ.get("CC") or shutil.which("cc"))
        return [] if own or self.target_name != "wheel" else ["ziglang>=0.13"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Have the library and uPlot's files in the package; say for which system the wheel is."""
        super().initialize(version, build_data)
        if self.target_name != "wheel":
            return
        target, _, tag = os.environ.get("REPLANT_WHEEL", "").partition(":")
        here = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        if here.endswith("universal2"):  # a Python of two processors; the library is of one
            here = "macosx_11_0_arm64" if platform.machine() == "arm64" else here.replace("universal2", "x86_64")
        build_data["pure_python"], build_data["tag"] = False, f"py3-none-{tag or here}"
        command = [sys.executable, str(Path(self.root, "tools/translator/library.py"))]
        if version != "editable":
            self._folder = tempfile.TemporaryDirectory()
            suffix = next((end for word, end in SUFFIXES.items() if word in (target or sys.platform)), "so")
            path = Path(self._folder.name, f"libreplant.{suffix}")
            build_data["force_include"][str(path)] = f"replant/kernels/compiled/{path.name}"
            command += ["--out", str(path), *(["--target", target] if target else [])]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode:
            raise SystemExit(f"replant: the kernels cannot be compiled: {done.stderr.strip()}")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was made for the wheel, which now has it."""
        if self._folder is not None:
            self._folder.cleanup()


def get_build_hook() -> type[PackageHook]:
    """Return the hook that hatchling is to use."""
    return PackageHook


def provide(folder: Path) -> None:
    """Have the files of uPlot in a folder, fetched unless they are there.

    Raises
    ------
    OSError
        They cannot be fetched.
    ValueError
        What came is not what it should be.
    """
    if all(_sum_of(folder / Path(name).name) == right for name, right in FILES.items()):
        return
    contents = _unpacked(_packed())
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        (folder / name).write_bytes(content)


def _sum_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _packed() -> bytes:
    """Return the npm package."""
    npm = shutil.which("npm")
    if npm is None:
        raise FileNotFoundError("there is no npm")
    with tempfile.TemporaryDirectory() as folder:
        command = [npm, "pack", PACKAGE, "--loglevel=error", "--ignore-scripts", "--pack-destination", folder]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, errors="replace", timeout=LONGEST, check=False
            )
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"`npm pack {PACKAGE}` did not end within {LONGEST} s") from None
        packed = [path.read_bytes() for path in Path(folder).glob("*.tgz")]
        if done.returncode or len(packed) != 1:
            said = " ".join(done.stderr.split()[-30:])
            raise OSError(f"`npm pack {PACKAGE}` failed: {said}")
        return packed[0]


def _unpacked(packed: bytes) -> dict[str, bytes]:
    """Return the files by name, each of which must be the very one that is known."""
    contents = {}
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        members = {member.name: member for member in archive if member.isfile()}
        for name, right in FILES.items():
            content = archive.extractfile(members[name]).read() if name in members else b""  # type: ignore[union-attr]
            if hashlib.sha256(content).hexdigest() != right:
                raise ValueError(f"{name} of the npm package {PACKAGE} is not the file that it should be")
            contents[Path(name).name] = content
    return contents
