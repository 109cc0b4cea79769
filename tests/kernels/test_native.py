"""The native library: made anew where the kernels have changed, and what is said where it is missing."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.kernels import native
from replant.kernels.filters.autoregressions import fill_play, play
from replant.kernels.filters.bank import whole_power
from support.cases import every
from support.compilers import without_optimization
from support.places import ROOT

USE = "import numpy as np; from replant.kernels.filters.autoregressions import play; print(play(np.array([3.0]), 1.0))"


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """Return a copy of what the library is made of, with the library."""
    unwanted = shutil.ignore_patterns("__pycache__")
    shutil.copytree(native.FOLDER, tmp_path / "src/replant/kernels", ignore=unwanted)
    shutil.copytree(ROOT / "tools/translator", tmp_path / "tools/translator", ignore=unwanted)
    for name in ("__init__.py", "errors.py"):
        shutil.copy(native.FOLDER.parent / name, tmp_path / "src/replant")
    return tmp_path


@pytest.fixture(scope="session")
def quick_compiler(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return without_optimization(tmp_path_factory.mktemp("compiler"))


IN_THREADS = """
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from replant.kernels.filters.autoregressions import play
with ThreadPoolExecutor(4) as pool:
    print([float(each[0]) for each in pool.map(lambda v: play(v, 1.0), [np.array([3.0])] * 4)])
"""


def use(clone: Path, code: str = USE, **more: str) -> subprocess.CompletedProcess[str]:
    """Call a kernel of the copy."""
    environment = {**os.environ, "PYTHONPATH": str(clone / "src"), **more}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow  # it compiles
def test_an_edit_of_a_kernel_takes_effect_and_is_said_once(clone: Path, quick_compiler: dict[str, str]) -> None:
    """Also where threads begin at once: the first of them makes the library for all."""
    assert (use(clone).stdout, use(clone).stderr) == ("[2.]\n", "")
    edited = clone / "src/replant/kernels/filters/autoregressions.py"
    edited.write_text(edited.read_text().replace("held, v[k] - width)", "held, v[k] - 2.0 * width)"))
    first, second = use(clone, IN_THREADS, **quick_compiler), use(clone)
    assert (first.stdout, second.stdout) == ("[1.0, 1.0, 1.0, 1.0]\n", "[1.]\n")
    assert re.fullmatch(r"replant: the source of the kernels has changed: compiling it .*\n", first.stderr)
    assert second.stderr == ""


def test_a_kernel_that_cannot_be_translated_is_named(clone: Path) -> None:
    edited = clone / "src/replant/kernels/filters/autoregressions.py"
    edited.write_text(edited.read_text().replace("    held = 0.0", "    held = sorted([0.0])"))
    done = use(clone)
    assert done.returncode
    last = done.stderr.strip().splitlines()[-1]
    assert "the kernels cannot be compiled" in last
    assert re.search(r"src/replant/kernels/filters/autoregressions\.py:\d+: .*List is no part of the subset", last)


TWICE = """
import sys
import numpy as np

def made():
    import replant as rp
    return rp.Identifier(rp.Structure(1), 0.1), rp.TransferFunction([2.0], [1.0, 0.5])

def take(identifier, samples):
    return [identifier.update(*sample) for sample in samples]

alone, plant = made()
u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 60), 10)
samples = list(zip(u, plant.simulate(u, 0.1)))
expected = take(alone, samples)
old, _ = made()
begun = take(old, samples[:3])
for name in [name for name in sys.modules if name.partition(".")[0] == "replant"]:
    del sys.modules[name]
new, _ = made()
assert type(new) is not type(old)
both = take(new, samples[:300]), begun + take(old, samples[3:]), take(new, samples[300:])
np.testing.assert_array_equal(both[1], expected)
np.testing.assert_array_equal(both[0] + both[2], expected)
"""


def test_a_process_may_import_the_package_twice() -> None:
    done = subprocess.run([sys.executable, "-c", TWICE], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_processes_that_begin_at_once_all_work(clone: Path, quick_compiler: dict[str, str]) -> None:
    shutil.rmtree(clone / "src/replant/kernels/compiled")
    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(lambda _: use(clone, **quick_compiler), range(2)))
    assert [one.stdout for one in done] == ["[2.]\n"] * 2
    assert any("is not compiled yet: compiling it" in one.stderr for one in done)
    assert [path.name for path in (clone / "src/replant/kernels/compiled").iterdir()] == [native.LIBRARY.name]


def test_a_library_of_another_system_is_made_again(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = clone / "src/replant/kernels", clone / "tools/translator"
    here = native.source_hash(*arguments)
    monkeypatch.setattr(native.platform, "machine", lambda: "another")
    assert native.source_hash(*arguments) != here


def test_without_compiler_the_error_says_what_to_install(clone: Path, tmp_path: Path) -> None:
    shutil.rmtree(clone / "src/replant/kernels/compiled")
    (tmp_path / "ziglang.py").write_text("raise ImportError")
    done = use(clone, PATH=str(tmp_path), CC="", PYTHONPATH=f"{clone / 'src'}:{tmp_path}")
    assert done.stderr.strip().splitlines()[-1].endswith("(Debian: apt install gcc libc6-dev), or pip install ziglang")


def test_an_installation_without_the_library_says_so(clone: Path) -> None:
    shutil.rmtree(clone / "src/replant/kernels/compiled")
    shutil.rmtree(clone / "tools")
    done = use(clone)
    assert "UnsupportedDependencyError: replant is installed without its compiled kernels" in done.stderr


def test_the_command_line_says_it_without_a_traceback(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("t_s,u,y\n" + "".join(f"{k / 10},{k // 7 % 2},{k // 5 % 3}\n" for k in range(200)))
    program = (
        "from pathlib import Path\nfrom replant.cli import main\nfrom replant.kernels import native\n"
        "native._builder, native.LIBRARY = (lambda: None), Path('gone.so')\n"
        f"main(['fit', {str(log)!r}, '--input', 'u', '--output', 'y', '--poles', '1'])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("replant: replant is installed without its compiled kernels, gone.so: ")
    assert done.stderr.count("\n") == 1


def test_interpreted_kernels_are_those_that_are_written() -> None:
    v = np.array([1.0, -2.0, 3.0])
    compiled = play(v, 0.5)
    with native.interpreted():
        np.testing.assert_array_equal(play(v, 0.5), compiled)
        with pytest.raises(AttributeError):  # no array, no check
            fill_play(None, 0.5, None)
    with pytest.raises(TypeError, match="v is no array"):
        fill_play(None, 0.5, None)


@every("exponent", [0, 1, 2, 3, 8, 13])
def test_whole_powers(exponent: int) -> None:
    assert whole_power(1.5, exponent) == 1.5**exponent


def test_a_state_with_shapes_of_its_own_is_sound() -> None:
    """The size of each block is the polynomial that `soundness` takes it for, whatever the structure."""
    from replant.kernels.step.soundness import is_laid_out

    for poles in (1, 2, 5):
        for zeros in range(poles):
            state = rp.Identifier(rp.Structure(poles, zeros, delay=0.3), 0.1, optimizer="amsgrad")._state
            assert is_laid_out(state.fields, state.reals.size, *state.banks.shape)
            assert not is_laid_out(state.fields, state.reals.size - 1, *state.banks.shape)


@pytest.mark.slow
@every("compiler", ["no-such-compiler", "cc 'x", "cc --no-such-option", "false"], quick=1)
def test_a_compiler_that_fails_is_said_in_one_line(compiler: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "tools/translator/library.py", "--out", tmp_path / "library.so"],
        env=os.environ | {"CC": compiler}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert len(done.stderr.splitlines()) == 1
    assert "compiler" in done.stderr
    assert not list(tmp_path.iterdir())
