"""The native library: translated, compiled, put into the package.  ``python -m translator.library`` from ``tools``.

The compiler is ``$CC``, else ``cc``, else the clang that the package ziglang brings along.  ``--target`` names another
system as zig does, for wheels.
"""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
#: ``-ffp-contract=off``: a product and a sum are rounded one by one, as Python does.  ``-fopenmp-simd``: loops over
#: `native.side_by_side` are said to have passes of their own; there are no threads.  ``-fomit-frame-pointer``: zig
#: keeps it, and a kernel of many numbers then waits for some of them a tenth of its time.
FLAGS = (
    "-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fopenmp-simd", "-fPIC", "-fvisibility=hidden",
    "-fomit-frame-pointer", "-Wno-psabi",
)  # fmt: skip
#: Of lanes, whose loops are vectors as they stand: -O3 takes half as long again, and clang's search for more vectors
#: makes an update of AMSGrad a tenth slower.
LANES_FLAGS = (*FLAGS, "-O2", "-fno-tree-vectorize")
#: What the compiler is told for an instruction set: see `border.VARIANTS`.
INSTRUCTIONS = {"plain": (), "avx2": ("-mavx2",), "avx512": ("-mavx512f", "-mprefer-vector-width=512")}
X86 = ("x86_64", "amd64", "AMD64")


ADVICE = "install one (Debian: apt install gcc libc6-dev), or pip install ziglang"


class BuildError(Exception):
    """The library cannot be made; the message says what to install."""


def compiler(target: str | None = None) -> list[str]:
    """Return the command of the compiler, for this system or a target of zig.

    Raises
    ------
    BuildError
        There is none.
    """
    if target is None and os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    if target is None and shutil.which("cc"):
        return ["cc"]
    try:
        importlib.import_module("ziglang")
    except ImportError:
        raise BuildError(f"there is no C compiler: {ADVICE}") from None
    # zig writes for this very processor where nothing is said, which is more than others may have
    system = ["-target", target] if target else ["-mcpu=baseline"]
    return [sys.executable, "-m", "ziglang", "cc", *system]


def generate(instead: Sequence[Any] = ()) -> tuple[dict[str, str], list[str]]:
    """Return the C files by name, and what the compiler is told: how many lanes, the hash of the sources.

    Kernels that take the place of the package's are accompanied by one step, as its types are part of the border.
    """
    sys.path.insert(0, str(ROOT / "src"))
    sys.path.insert(0, str(ROOT / "tools"))
    import replant.kernels
    from replant.kernels import lanes, native
    from translator.border import sources

    for module in pkgutil.walk_packages(replant.kernels.__path__, "replant.kernels."):
        importlib.import_module(module.name)
    own = [kernel for kernel in native.KERNELS if kernel.python.__module__.startswith(replant.kernels.__name__)]
    if instead:
        own = [*instead, *(kernel for kernel in own if kernel.name == "step.fixed_filter.step")]
    kernels = sorted(own, key=lambda kernel: kernel.name)
    source = native.source_hash(native.FOLDER, Path(__file__).parent)
    return sources("replant.kernels", ROOT, kernels), [f'-DREPLANT_SOURCE="{source}"', f"-DLANES={lanes.LANES}"]


def build(path: Path, *, target: str | None = None, keep: Path | None = None, instead: Sequence[Any] = ()) -> None:
    """Make the library.

    Parameters
    ----------
    path : Path
        Where to put it, once it is whole: another process may load it meanwhile.
    target : str, optional
        Another system, as zig names it.
    keep : Path, optional
        Folder for the C files.
    instead : sequence of Kernel
        What the library is to have in place of the package's kernels.

    Raises
    ------
    BuildError
        There is no compiler, or it fails.
    """
    command = compiler(target)
    files, defined = generate(instead)
    from translator.border import VARIANTS

    x86 = (target or platform.machine()).partition("-")[0] in X86
    with tempfile.TemporaryDirectory() as made:
        folder = keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, "utf-8")
        given = [*defined, *(["-DWITH_VARIANTS"] if x86 else [])]
        objects = [folder / "border.o"]
        jobs = [[*command, *FLAGS, *given, "-c", str(folder / "border.c"), "-o", str(objects[0])]]
        for name, wider in VARIANTS.items():
            for variant in ("plain", *(wider if x86 else ())):
                flags = [*(LANES_FLAGS if name == "lanes" else FLAGS), *given, *INSTRUCTIONS[variant]]
                objects.append(folder / f"{name}_{variant}.o")
                own = [*flags, f"-DVARIANT={variant}", "-c", str(folder / f"{name}.c")]
                jobs.append([*command, *own, "-o", str(objects[-1])])
        whole = Path(made, path.name)
        link = [*command, "-shared", "-s", *map(str, objects), "-o", str(whole)]
        system = (target or sys.platform).replace("win32", "windows").replace("darwin", "macos")
        if "windows" not in system:
            link.append("-lm")
        if "macos" in system:
            link.append(f"-Wl,-install_name,@rpath/{path.name}")  # else the library names the folder it was made in
        _run_together(jobs)
        _run_together([link])
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_name(f"{path.name}.{os.getpid()}")
        shutil.copyfile(whole, beside)
        beside.replace(path)


def _run_together(commands: list[list[str]]) -> None:
    running = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
        for command in commands
    ]
    for command, process in zip(commands, running, strict=True):
        said = process.communicate()[0]
        if process.returncode:
            lines = [line for line in said.splitlines() if line.strip()] or ["it says nothing"]
            reason = next((line for line in lines if "error" in line or "fatal" in line), lines[0])
            raise BuildError(f"the C compiler {command[0]} ends with {process.returncode}: {reason.strip()}; {ADVICE}")


def main() -> None:
    """Make the library of this clone."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--out", type=Path, help="where to put it, else into the package")
    parser.add_argument("--target", help="another system, as zig names it")
    parser.add_argument("--keep", type=Path, help="folder for the C files")
    arguments = parser.parse_args()
    sys.path.insert(0, str(ROOT / "src"))
    from replant.kernels import native

    try:
        build(arguments.out or native.LIBRARY, target=arguments.target, keep=arguments.keep)
    except BuildError as error:
        raise SystemExit(str(error)) from None
    except (OSError, ValueError) as error:
        reason = f"{error}: see to it that CC names a C compiler, and that the folder can be written"
        raise SystemExit(reason) from None


if __name__ == "__main__":
    main()
