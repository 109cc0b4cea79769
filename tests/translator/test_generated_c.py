"""The C that is made of the kernels, as compilers and analyzers see it."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
from translator.library import X86, generate

FILES = ["border.c", "kernels.c", "lanes.c"]
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-fopenmp-simd"]
#: What is used of a file in one of its variants alone, and how vectors are passed between functions that melt away.
NOT_MEANT = ["-Wno-unused-function", "-Wno-psabi"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The C files, and what is defined for them."""
    folder = tmp_path_factory.mktemp("c")
    files, defined = generate()
    assert sorted(files) == FILES
    for name, text in files.items():
        (folder / name).write_text(text, "utf-8")
    more = ["-DWITH_VARIANTS"] if platform.machine() in X86 else []
    return folder, [*defined, *more, "-DVARIANT=plain"]


def look(made: tuple[Path, list[str]], tool: str, *options: str) -> None:
    """Let a program look at C files; that it finds anything is a failure."""
    folder, defined = made
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed: apt install {tool}")
    done = subprocess.run([tool, *options, *defined], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_compiler_warns(made: tuple[Path, list[str]], compiler: str, file: str) -> None:
    look(made, compiler, *WARNINGS, *NOT_MEANT, "-fsyntax-only", file)


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES)
def test_the_analyzer_of_clang_finds_nothing(made: tuple[Path, list[str]], file: str) -> None:
    options = ["--analyzer-output", "text", "-Xclang", "-analyzer-werror", "-std=c99"]
    look(made, "clang", "--analyze", *options, file)
