"""Sixteen numbers at once, one of each member of an ensemble: a lane holds the bits of a double, at each width."""

from __future__ import annotations

import ctypes
import itertools
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
from translator.border import VARIANTS
from translator.library import INSTRUCTIONS, LANES_FLAGS, X86, BuildError, compiler

CPU = Path("/proc/cpuinfo")
LANES, VALUES = 16, [np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 2.5]
#: What is done with lanes, and with doubles, a and b; the lanes a lie at p.
OPERATIONS = {
    **{"sum(a, b)": "a + b", "difference(a, b)": "a - b", "product(a, b)": "a * b", "quotient(a, b)": "a / b"},
    **{"minus(a)": "-a", "lanes_abs(a)": "fabs(a)", "lanes_root(a)": "sqrt(a)"},
    **{"max_l(a, b)": "max_d(a, b)", "min_l(a, b)": "min_d(a, b)", "lanes_if(*p < 0.0, a, b)": "*p < 0.0 ? a : b"},
    "if_less(a, b, minus(b), quotient(a, b))": "a < b ? -b : a / b",
    "if_at_most(a, b, minus(b), quotient(a, b))": "a <= b ? -b : a / b",
    **{"broadcast(p[3])": "p[3]", "gathered(p, places, 1)": "p[places[k] + 1]"},
}
SOURCE = f"""
#include "prelude.h"
#include "lanes.h"
#if defined(SERVES)
#include "processor.h"
EXPORTED int is_there(void) {{ return SERVES(); }}
#endif
EXPORTED int within(const double *p, double limit) {{ return all_within(*(const lanes *)p, limit); }}
EXPORTED void done(const double *p, const double *q, double *of_lanes, double *of_doubles)
{{
    static const int64_t places[] = {{ 14, 0, -1, 3, 3, 9, 8, 7, 6, 5, 4, 2, 1, 10, 11, 12 }};
    const lanes a = *(const lanes *)p, b = *(const lanes *)q, found[] = {{ {", ".join(OPERATIONS)} }};
    memcpy(of_lanes, found, sizeof found);
    for (int k = 0; k < LANES; k++) {{
        const double a = p[k], b = q[k], expected[] = {{ {", ".join(OPERATIONS.values())} }};
        for (int i = 0; i < {len(OPERATIONS)}; i++)
            of_doubles[i * LANES + k] = expected[i];
    }}
}}
"""


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ctypes.CDLL]:
    """Return what is compiled for each instruction set of this processor."""
    folder, found = tmp_path_factory.mktemp("lanes"), {}
    (folder / "made.c").write_text(SOURCE, "utf-8")
    for variant in ("plain", *(VARIANTS["lanes"] if platform.machine() in X86 else ())):
        more = [] if variant == "plain" else [f"-DSERVES=serves_{variant}"]
        flags = [*LANES_FLAGS, *INSTRUCTIONS[variant], f"-DLANES={LANES}", f"-I{ROOT / 'tools' / 'translator'}", *more]
        made = folder / f"{variant}.so"
        try:
            command = [*compiler(), *flags, "-shared", str(folder / "made.c"), "-o", str(made), "-lm"]
        except BuildError as error:
            pytest.skip(str(error))
        subprocess.run(command, check=True)
        library = ctypes.CDLL(str(made))
        if variant == "plain" or library.is_there():
            found[variant] = library
    return found


def library_of(libraries: dict[str, ctypes.CDLL], variant: str) -> ctypes.CDLL:
    if variant not in libraries:
        pytest.skip(f"this processor has no {variant}")
    return libraries[variant]


def bits(numbers: np.ndarray) -> list[list[int]]:
    """Return the bits of doubles; of what is no number they are not told apart."""
    return np.where(np.isnan(numbers), np.nan, numbers).view(np.int64).tolist()


@pytest.mark.skipif(not CPU.exists(), reason="no /proc/cpuinfo: the system does not say what the processor has")
def test_the_processor_has_what_the_system_says_it_has(libraries: dict[str, ctypes.CDLL]) -> None:
    """Whichever compiler has built the library; some answer no for every processor."""
    said = CPU.read_text("ascii").split()
    assert ("avx2" in libraries, "avx512" in libraries) == ("avx2" in said, "avx512f" in said)


@every("variant", INSTRUCTIONS)
def test_each_lane_gets_the_bits_of_a_double(variant: str, libraries: dict[str, ctypes.CDLL]) -> None:
    done = library_of(libraries, variant).done
    pairs = np.array(list(itertools.product(VALUES, VALUES)))
    for first, shift in itertools.product(range(0, len(pairs), LANES), range(LANES)):
        a, b = (np.roll(pairs[first : first + LANES], shift, axis=0).T).copy()
        of_lanes, of_doubles = np.empty((2, len(OPERATIONS), LANES))
        done(*(ctypes.c_void_p(each.ctypes.data) for each in (a, b, of_lanes, of_doubles)))
        for name, *rows in zip(OPERATIONS, bits(of_lanes), bits(of_doubles), strict=True):
            assert rows[0] == rows[1], (name, a, b)


@every("variant", INSTRUCTIONS)
def test_every_lane_counts_where_all_have_to_be_within_a_limit(variant: str, libraries: dict[str, ctypes.CDLL]) -> None:
    within = library_of(libraries, variant).within
    for lane, (value, expected) in itertools.product(
        range(LANES),
        {2.0: 1, -2.0: 1, -0.0: 1, np.nextafter(2.0, 3.0): 0, -2.1: 0, np.inf: 0, -np.inf: 0, np.nan: 0}.items(),
    ):
        numbers = np.ones(LANES)
        numbers[lane] = value
        assert within(ctypes.c_void_p(numbers.ctypes.data), ctypes.c_double(2.0)) == expected, (lane, value)
