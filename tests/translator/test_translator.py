"""The translator: small functions mean the same in C, and what is no part of the subset is named with its place."""

from __future__ import annotations

import ctypes
import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
from translator.kinds import UnsupportedError
from translator.library import FLAGS, BuildError, compiler
from translator.program import Program, entry_kinds

HEADER = (
    "from __future__ import annotations\nimport math\nimport numpy as np\n"
    "from replant.kernels.native import side_by_side\n"
    "from replant.kernels.schema import SCALARS, Doubt, StateSlots\nLIMIT = 3\nPAIR = (2, 5)\n"
)


def module_of(source: str, folder: Path) -> ModuleType:
    path = folder / "made.py"
    path.write_text(HEADER + source)
    spec = importlib.util.spec_from_file_location("made", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["made"] = module
    spec.loader.exec_module(module)
    return module


def text_of(source: str, folder: Path) -> str:
    program, module = Program("replant.kernels", folder), module_of(source, folder)
    program.function(module.f, entry_kinds(module.f))
    return program.text(lanes=False)


def compiled(source: str, folder: Path) -> tuple[Callable[..., float], Callable[..., float]]:
    """Return ``f`` of some source of one float argument, as it is and in C."""
    text = text_of(source, folder) + "\nEXPORTED double call(double x) { return (double)made_f(x); }\n"
    (folder / "made.c").write_text(text)
    library = folder / "made.so"
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-Wno-unused-function"]
    subprocess.run(
        [*compiler(), *FLAGS, *warnings, "-shared", str(folder / "made.c"), "-o", str(library), "-lm"], check=True
    )
    call = ctypes.CDLL(str(library)).call
    call.restype, call.argtypes = ctypes.c_double, [ctypes.c_double]
    return sys.modules["made"].f, call


MEANINGS = {
    "sums that begin as whole numbers": (
        "def f(x: float):\n    s = 0\n    for i in range(5):\n        s += i * x\n    return s"
    ),
    "division of whole numbers, down": "def f(x: float):\n    a = int(x)\n    return a // 3 * 100 + a % 3",
    "exchange": "def f(x: float):\n    a, b = x, 2.0 * x\n    a, b = b, a\n    return a - 3.0 * b",
    "chains of comparisons": "def f(x: float):\n    return 1 if -1.0 < x <= 2.0 else 0",
    "max and min of equals": "def f(x: float):\n    return max(x, 2.0) - min(1, x)",
    "loops over constants": (
        "def f(x: float):\n    s = x\n    for i, part in enumerate(PAIR):\n        s += (i + 1) * part\n    return s"
    ),
    "loops downwards": (
        "def f(x: float):\n    s = x\n    for i in range(LIMIT, -1, -1):\n        s = s * 2.0 + i\n    return s"
    ),
    "while, break and continue": (
        "def f(x: float):\n    n = 0\n    while True:\n        n += 1\n        if n % 2 == 1:\n            continue\n"
        "        if n > x:\n            break\n    return n"
    ),
    "functions as arguments": (
        "def once(x):\n    return x + 1.0\ndef twice(g, x):\n"
        "    return g(g(x))\ndef f(x: float):\n    return twice(once, x)"
    ),
    "several results": "def both(x):\n    return x, -x\ndef f(x: float):\n    a, b = both(x)\n    return a - b",
    "tuples of tuples, taken apart and handed on": (
        "def g(pair, x):\n    inner, scale = pair\n    a, b = inner\n    for i in range(3):\n"
        "        x += a * scale + b + i\n    return x\n"
        "def f(x: float):\n    inner = (x, 2.0 * x)\n    pair = (inner, 3.0)\n    other = pair[0]\n"
        "    inner = (x + 1.0, x)\n    last = inner\n    inner = (5.0, x)\n"
        "    x += g((other, 1.0), x) + g(((x, x), x), x)\n"
        "    return g(pair, x) + 7.0 * other[1] + 11.0 * inner[0] + 13.0 * last[0]"
    ),
    "constants of other modules": "def f(x: float):\n    return x + SCALARS + Doubt.MISSING",
    "numbers that are none": "def f(x: float):\n    return 1.0 if math.isnan(x - x) or math.isinf(x) else np.nan",
    "whole numbers without sign": (
        "def f(x: float):\n"
        "    z = np.uint64(int(x)) * np.uint64(0x9E3779B97F4A7C15)\n    return np.int64(z >> np.uint64(32))"
    ),
}


@every("source", MEANINGS.values(), ids=MEANINGS)
@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_a_function_means_the_same_in_c(source: str, tmp_path: Path) -> None:
    plain, in_c = compiled(source, tmp_path)
    for x in (7.0, 0.0, 1.0, 2.0, 2.5, 5.0):
        np.testing.assert_array_equal(in_c(x), float(plain(np.float64(x))))


REFUSED: dict[str, tuple[str, str]] = {
    "a list": ("def f(x: float):\n    a = [x]\n    return a", "List is no part of the subset"),
    "a loop over an array": ("def f(x: Reals):\n    for each in x:\n        pass", "a loop over something else"),
    "whole powers": ("def f(x: float):\n    return x ** 2", r"\*\* of a whole number"),
    "two kinds": ("def f(x: Reals):\n    a = x\n    a = 1.0\n    return a", "a value is reals1 and double"),
    "a name that is not there": ("def f(x: float):\n    return x + y", "y is not known here"),
    "a function of NumPy": ("def f(x: Reals):\n    return np.sum(x)", "a call of np.sum, which is no kernel"),
    "a function of math": ("def f(x: float):\n    return math.gamma(x)", "math.gamma is no part"),
    "an index that is a float": ("def f(x: Reals):\n    return x[0.5]", "0.5 is double and serves as an index"),
    "a counter that is assigned": ("def f(x: float):\n    for i in range(3):\n        i = 4", "i counts the loop"),
    "an attribute": ("def f(x: Reals):\n    return x.T", r"\.T of reals1"),
    "a call of itself": ("def f(x: float):\n    return f(x)", "f calls itself"),
    "a slot that is not there": (
        "def f(s: StateSlots):\n    return s.alarms",
        "no slot of StateSlots is called alarms",
    ),
    "another shape of a matrix": ("def f(x: Matrix):\n    return x.reshape(2, 3)[0, 0]", "another shape of reals2"),
    "with": ("def f(x: float):\n    with x:\n        pass", "With is no part of the subset"),
}


@every(("source", "reason"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_translated_is_named_with_file_and_line(source: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match=reason) as refused:
        text_of(source, tmp_path)
    lines = HEADER.count("\n")
    assert str(refused.value).startswith(f"made.py:{lines + 2}: ") or f"made.py:{lines + 3}: " in str(refused.value)


def test_a_field_is_that_of_a_struct_over_its_array(tmp_path: Path) -> None:
    """Numbers by their names, blocks by a function that cuts them out, an index of a row behind it."""
    text = text_of(
        "def f(s: StateSlots):\n    s.alarm = Doubt.NONE\n    s.theta[2] = s.error\n    return s.noise.models[1, 2]",
        tmp_path,
    )
    assert "s->ints->alarm = Doubt_NONE;" in text
    assert "state_theta(s).p[2] = s->reals->error;" in text
    assert "return noise_models(state_noise(s)).p[(1) * noise_models(state_noise(s)).n1 + 2];" in text


def test_an_argument_without_a_kind_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match=r"made\.py:\d+: x needs one of the annotations bool, int, float, Ints"):
        text_of("def f(x):\n    return x", tmp_path)


def test_names_comments_and_docstrings_stay(tmp_path: Path) -> None:
    text = text_of(
        'def f(x: Reals):\n    """Return the limit."""\n'
        "    # before\n    a = x[SCALARS]  # beside\n    return a + LIMIT",
        tmp_path,
    )
    assert "#define made_LIMIT 3" in text
    assert "double a = x.p[at_SCALARS];  /* beside */" in text
    assert "/* before */" in text
    assert "Return the limit." in text


def test_passes_side_by_side_have_variables_of_their_own(tmp_path: Path) -> None:
    source = "def f(x: Reals):\n    for i in side_by_side(x.size):\n        g = 2.0 * x[i]\n        x[i] = g + g * g"
    text = text_of(source, tmp_path)
    assert "SIDE_BY_SIDE\n    for (int64_t i = 0" in text
    assert "double g = 2.0 * x.p[i];\n" in text
    with pytest.raises(UnsupportedError, match=r"g is used outside of the passes side by side"):
        text_of(source + "\n    x[0] = g", tmp_path)


def test_what_is_written_is_known_through_parts_and_calls(tmp_path: Path) -> None:
    source = (
        "def g(b):\n    b[0] = 1.0\ndef f(x: Reals, y: Reals, z: Reals):\n"
        "    part = y[1:]\n    g(part)\n    z[0] = x[0]"
    )
    program, module = Program("replant.kernels", tmp_path), module_of(source, tmp_path)
    assert program.function(module.f, entry_kinds(module.f)).written == {"y", "z"}


def test_without_a_compiler_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "ziglang", None)
    with pytest.raises(BuildError, match=r"install one .* or pip install ziglang"):
        compiler()


def test_the_compiler_is_the_one_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc -m64")
    assert compiler() == ["gcc", "-m64"]
    monkeypatch.setitem(sys.modules, "ziglang", ModuleType("ziglang"))
    assert compiler("aarch64-linux-gnu")[1:] == ["-m", "ziglang", "cc", "-target", "aarch64-linux-gnu"]


def test_zig_writes_for_every_processor_of_the_system(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "ziglang", ModuleType("ziglang"))
    assert compiler()[1:] == ["-m", "ziglang", "cc", "-mcpu=baseline"]
