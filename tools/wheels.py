"""Wheels for every system from one machine: `make wheels` builds and checks them, `make wheels-test` tries them.

The compiler is the clang of the package ziglang.  A wheel has a library of C alone, linked with no Python: one serves
every version.  Those for Linux are checked by auditwheel; of all, the names that the library offers are looked at.
The wheel of this system is tried, and under QEMU's user mode that for Linux on ARM, which has to print the same.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

from foreign import PROCESSORS, UntriedError
from foreign import try_out as try_under_qemu

ROOT = Path(__file__).resolve().parents[1]
#: The tag of each wheel, and its system as zig names it.
TARGETS = {
    "manylinux_2_17_x86_64.manylinux2014_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_17_aarch64.manylinux2014_aarch64": "aarch64-linux-gnu.2.17",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "macosx_10_15_x86_64": "x86_64-macos.10.15",
    "win_amd64": "x86_64-windows-gnu",
}
OFFERED = [b"replant_connect", b"replant_call_definition", b"replant_step_definition", b"replant-source:"]
TRY = """
import hashlib, numpy as np, replant as rp
u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 60), 10)
y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, 0.1)
identifier = rp.Identifier(rp.Structure(1), 0.1)
identifier.update_many(u, y)
print(identifier.update(1.0, 0.0) is not None, identifier.transfer_function)
lowpass = rp.StateVariableFilter(1.0)  # what has no least squares has the same bits everywhere: all of it is kernels
fixed = rp.Identifier(rp.Structure(1), 0.1, filter=lowpass, scaling=None, optimizer="amsgrad", instruments=False)
fixed.update_many(u, 0.01 * np.cumsum(u))
bits = b"".join(np.where(np.isnan(each), 0, each).tobytes() for each in fixed._state.arrays)
print("bits of a state:", hashlib.sha256(bits).hexdigest()[:16])
"""


def build(folder: Path) -> None:
    """Build all wheels into a folder, and check them."""
    for tag, target in TARGETS.items():
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
        subprocess.run(command, cwd=ROOT, env={**os.environ, "REPLANT_WHEEL": f"{target}:{tag}"}, check=True)
        (wheel,) = folder.glob(f"*-py3-none-{tag}.whl")
        check(wheel)
        if "linux" in tag:
            subprocess.run([sys.executable, "-m", "auditwheel", "show", str(wheel)], check=True)


def check(wheel: Path) -> None:
    """Refuse a wheel whose library does not offer what Python calls, or names a folder of this machine."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if name.startswith("replant/kernels/compiled/libreplant.")]
        content = archive.read(names[0]) if len(names) == 1 else b""
    missing = [name.decode() for name in OFFERED if name not in content]
    if missing:
        raise SystemExit(f"{wheel.name} has {names or 'no library'}: {', '.join(missing)} missing")
    if tempfile.gettempdir().encode() in content:
        raise SystemExit(f"{wheel.name}: {names[0]} names the folder that it was made in")


def try_out(folder: Path) -> None:
    """Install the wheels that run here into fresh environments, and identify a plant; say what is not tried."""
    told = set()
    machine = {"AMD64": "x86_64"}.get(platform.machine(), platform.machine())
    for tag, target in TARGETS.items():
        wheels = list(folder.glob(f"*-py3-none-{tag}.whl"))
        here = (
            target.startswith(machine) and sys.platform.replace("darwin", "macos").replace("win32", "windows") in target
        )
        if not wheels:
            raise SystemExit(f"there is no wheel for {tag} in {folder}: make wheels")
        processor = target.partition("-")[0]
        if not here and not (sys.platform == "linux" and "linux" in target and processor in PROCESSORS):
            print(f"{wheels[0].name}: not tried: it is of another system")
            continue
        with tempfile.TemporaryDirectory() as fresh:
            if not here:
                try:
                    said = try_under_qemu(wheels[0], processor, TRY, Path(fresh), ROOT / "constraints.txt")
                except UntriedError as reason:
                    print(f"{wheels[0].name}: not tried: {reason}")
                    continue
                print(f"{wheels[0].name}: run under QEMU, and a plant was identified:\n{said}", end="")
                told.add(said)
                continue
            venv.create(fresh, with_pip=True)
            python = Path(fresh, "Scripts/python.exe" if os.name == "nt" else "bin/python")
            hidden = {**os.environ, "PATH": str(python.parent)}
            hidden.pop("PYTHONPATH", None)
            pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheels[0]]
            subprocess.run(pip, check=True)
            run = [python, "-c", TRY]
            said = subprocess.run(run, env=hidden, cwd=fresh, check=True, capture_output=True, text=True).stdout
        print(f"{wheels[0].name}: installed without a compiler, and a plant was identified:\n{said}", end="")
        told.add(said)
    if len(told) > 1:
        raise SystemExit("the wheels do not say the same")


def main() -> None:
    """Build the wheels, or try them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument("--try", dest="tried", action="store_true", help="try those that are there")
    arguments = parser.parse_args()
    if arguments.tried:
        try_out(arguments.out)
        return
    shutil.rmtree(arguments.out, ignore_errors=True)
    build(arguments.out)


if __name__ == "__main__":
    main()
