"""Speed of the kernels beside a C program of the same loop (reference.c), as ratios measured in one run.

For each optimizer, number of parameters P and buffer, both programs start from the same state, take the same chunks
of samples in turn, and must end with the same numbers.  A ratio is the median, over the chunks, of our time by that of
C for the same chunk; times are processor times of the thread, so that other programs on the machine hardly count.
Exit code 1 says that a ratio exceeds the limit or that the numbers differ, 2 that there is no gcc.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

import replant as rp
from replant.estimation.engine.state import State
from replant.estimation.optimizers import Optimizer
from replant.estimation.settings import STORED, Settings
from replant.estimation.solver.least_squares import regressors

ARTICLE = {
    "Gradient": rp.Gradient(gain=2.0),
    "Adam": rp.Adam(step_size=1e-3),
    "AMSGrad": rp.AMSGrad(step_size=1e-3),
    "IntegralCost": rp.IntegralCost(gain=2.0, forgetting_rate=0.1),
}
OTHERS = {
    "AdaGrad": rp.AdaGrad(step_size=1e-2),
    "RMSProp": rp.RMSProp(step_size=1e-3),
    "NAdam": rp.NAdam(step_size=1e-3),
    "AdaDelta": rp.AdaDelta(),
}
REPLAY = rp.Replay(capacity=20_000, batch_size=20)
DT = 1e-3
CHUNK = {True: 1_000, False: 10_000}  # samples, with and without replay: under a millisecond
SAME = 1e-9  # relative
ENTRIES, REPETITIONS = (2, 4, 6, 8, 10), 102
ROUNDS = 3  # what else the machine does for some seconds spoils a third of a case's chunks at the most
LIMIT, LIMIT_OTHERS = 1.1, 1.25  # of the ratio: the article's four optimizers, the rest
REGULAR = np.zeros(0)  # time stamps of a regular clock

# What the flags after -march do changes no number: no fused multiply-add, which our library does not use either and
# which would round differently; no errno and no traps, without which gcc cannot vectorise a square root or a maximum.
FLAGS = "-O3 -march=native -ffp-contract=off -fno-math-errno -fno-trapping-math"

Run = Callable[..., None]


def main() -> int:
    options = read_options()
    console = Console(width=None if sys.stdout.isatty() else 120)
    if shutil.which("gcc") is None:
        console.print("gcc is not on the PATH: install it to build the C program that the kernels are compared with")
        return 2
    optimizers = ARTICLE | OTHERS if options.all else ARTICLE
    results = measure_all(optimizers, options.entries, options.repetitions, options.flags)
    worst = max(results, key=lambda result: result.ratio)
    difference = max(result.difference for result in results)
    console.print(as_table(results, options.limit))
    console.print(
        f"Largest ratio {worst.ratio:.2f} ({worst.optimizer}, P = {worst.entries}, "
        f"{'with' if worst.replay else 'without'} replay); limit {options.limit:g}.\n"
        f"Largest difference between the two programs' numbers: {difference:.1e} relative; allowed {SAME:g}."
    )
    console.print("\n".join(f"{key}: {value}" for key, value in describe_machine(options.flags).items()))
    return int(worst.ratio > options.limit or not difference <= SAME)


def measure() -> dict[str, Any]:
    """Return the figures: ``rows``, one for each optimizer, number of parameters and buffer."""
    results = measure_all(ARTICLE | OTHERS, ENTRIES, REPETITIONS, FLAGS)
    holds = all(
        result.difference <= SAME and result.ratio <= (LIMIT if result.optimizer in ARTICLE else LIMIT_OTHERS)
        for result in results
    )
    return {"rows": [asdict(result) | {"update": result.update} for result in results], "holds": holds}


def measure_all(optimizers: dict[str, Optimizer], entries: Sequence[int], repetitions: int, flags: str) -> list[Result]:
    """Measure every optimizer at every number of parameters, without and with replay, in `ROUNDS` through them all."""
    cases = [(name, P, replay) for name in optimizers for P in entries for replay in (False, True)]
    found: dict[tuple[str, int, bool], list[Times]] = {case: [] for case in cases}
    with tempfile.TemporaryDirectory() as folder:
        run = compile_reference(Path(folder), flags)
        for case in track(cases * ROUNDS, "kernels", console=Console(stderr=True), transient=True):
            name, P, replay = case
            found[case].append(time_both(optimizers[name], P, replay, run, -(-repetitions // ROUNDS)))
    return [result_of(*case, times) for case, times in found.items()]


def read_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--all", action="store_true", help="all eight optimizers, not the article's four alone")
    parser.add_argument(
        "--entries", type=int, nargs="+", default=ENTRIES, metavar="P", help="2 or more; odd: with a bias"
    )
    parser.add_argument("--repetitions", type=int, default=REPETITIONS, metavar="N", help="chunks that are timed")
    parser.add_argument("--limit", type=float, default=1.5, metavar="X", help="largest ratio that passes")
    parser.add_argument("--flags", default=FLAGS, help="of gcc; default: %(default)s")
    return parser.parse_args()


# --- the C program


class Program(ctypes.Structure):
    """The `identifier` of reference.c, filled for the same settings as ours."""

    SIZES: ClassVar = (
        "order", "entries", "input_entries", "memory_size", "algorithm", "square_input", "normalize", "lag", "capacity",
        "batch", "warmup", "seed", "recent_rows",
    )  # fmt: skip
    NUMBERS: ClassVar = ("input_offset", "output_offset", "output_scale", "interval")
    CONSTANTS: ClassVar = (
        "transition", "output_taps", "input_taps", "characteristic", "gain", "unit", "settings",
    )  # fmt: skip
    COUNTERS: ClassVar = ("started", "samples", "rejected", "refused", "filled", "head", "drawn", "past", "recent_head")
    STATE: ClassVar = (
        "output_state", "input_state", "past_inputs", "past_held", "past_intervals", "recent", "phi", "theta", "memory",
        "backup",
    )  # fmt: skip
    _fields_: ClassVar = [
        *((name, ctypes.c_int64) for name in SIZES),
        *((name, ctypes.c_double) for name in NUMBERS),
        *((name, ctypes.c_void_p) for name in CONSTANTS),
        *((name, ctypes.c_int64) for name in COUNTERS),
        ("last_output", ctypes.c_double),
        ("elapsed", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in (*STATE, "buffer", "rows")),
    ]

    def __init__(self, settings: Settings, state: State) -> None:
        """Copy an identifier before its first sample; the filters come from SciPy's matrix exponential."""
        structure = settings.structure
        n, inputs, P, M = structure.poles, structure.zeros + 1, state.entries, state.memory_size
        discrete = settings.filter.discretize(n, settings.dt, structure.delay)
        sizes = [n, P, inputs, M, state.algorithm, 0, settings.normalize, discrete.lag]
        sizes += [state.capacity, state.batch_size, state.warmup, state.seed, state.recent_size]
        super().__init__(
            **dict(zip(self.SIZES, sizes, strict=True)),
            input_offset=settings.preprocess.input_offset,
            output_offset=settings.preprocess.output_offset,
            output_scale=settings.scaling.output,
            interval=settings.dt,
        )
        signs = np.concatenate([-1 / discrete.scale, 1 / discrete.scale[n - inputs :], np.ones(int(structure.bias))])
        self.arrays = {
            "transition": discrete.transition.ravel(),
            "output_taps": discrete.output_taps.ravel(),
            "input_taps": discrete.input_taps.ravel(),
            "characteristic": discrete.characteristic,
            "gain": signs / settings.scaling.sigmas(structure),
            "unit": state.unit.copy(),
            "settings": state.settings.copy(),
            "output_state": np.zeros(n),
            "input_state": np.zeros(n),
            "past_inputs": np.zeros(discrete.lag + 3),
            "past_held": np.zeros(discrete.lag + 3),
            "past_intervals": np.zeros(discrete.lag + 3),
            "recent": state.recent.copy(),
            "phi": np.zeros(P),
            "theta": state.theta.copy(),
            "memory": state.memory.copy(),
            "backup": np.zeros(max(P + M, 2 * n)),
            "buffer": state.buffer.copy(),
            "rows": np.zeros(state.batch_size, np.int64),
        }
        for name, array in self.arrays.items():
            setattr(self, name, array.ctypes.data)


def compile_reference(folder: Path, flags: str) -> Run:
    """Build reference.c and return its `run`."""
    source, library = Path(__file__).with_name("reference.c"), folder / "reference.so"
    subprocess.run(["gcc", *shlex.split(flags), "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
    run = ctypes.CDLL(str(library)).run
    run.argtypes = [ctypes.c_void_p, ctypes.c_int64] + [ctypes.c_void_p] * 4
    run.restype = None
    return run


# --- measuring


@dataclass(frozen=True)
class Result:
    """One optimizer, number of parameters and buffer; medians of times in ns."""

    optimizer: str
    entries: int
    replay: bool
    updates_per_sample: int
    sample: float
    sample_c: float
    ratio: float
    ratio_quartiles: tuple[float, float]
    difference: float

    @property
    def update(self) -> float:
        return self.sample / self.updates_per_sample

    @property
    def update_c(self) -> float:
        return self.sample_c / self.updates_per_sample


Times = tuple[np.ndarray, float]  # (chunks, 2): ns a sample of ours and of C; the largest relative difference


def time_both(optimizer: Optimizer, P: int, replay: bool, run: Run, repetitions: int) -> Times:
    """Time both programs on the same chunks in turn, and compare their numbers."""
    from replant.kernels.step.fixed_filter import steps

    structure, size = rp.Structure(poles=P // 2, zeros=P // 2 - 1, bias=bool(P % 2)), CHUNK[replay]
    settings = settings_for(structure, optimizer, replay)
    state = State.of_settings(settings, STORED)
    program, arrays = Program(settings, state), (state.ints, state.reals, state.banks, state.buffer, state.recent)
    ours, theirs = (np.empty(size), np.empty((size, P))), (np.empty(size), np.empty((size, P)))
    pointers = [array.ctypes.data for array in theirs]
    warm = math.ceil(REPLAY.capacity / size)  # chunks, until the buffer is full
    times, difference = [], 0.0
    for u, y in chunks(structure, size, warm + repetitions):
        start = time.thread_time_ns()
        steps(*arrays, u, y, REGULAR, REGULAR, *ours)
        middle = time.thread_time_ns()
        run(ctypes.addressof(program), size, u.ctypes.data, y.ctypes.data, *pointers)
        times.append((middle - start, time.thread_time_ns() - middle))
        difference = max(difference, *(distance(a, b) for a, b in zip(ours, theirs, strict=True)))
    return np.array(times[warm:]) / size, difference


def result_of(name: str, P: int, replay: bool, found: Sequence[Times]) -> Result:
    """Return the medians over all rounds."""
    measured = np.concatenate([times for times, _ in found])
    sample, sample_c = np.median(measured, axis=0).tolist()
    low, ratio, high = np.percentile(measured[:, 0] / measured[:, 1], [25, 50, 75]).tolist()
    updates, difference = REPLAY.batch_size if replay else 1, max(difference for _, difference in found)
    return Result(name, P, replay, updates, sample, sample_c, ratio, (low, high), difference)


def settings_for(structure: rp.Structure, optimizer: Optimizer, replay: bool) -> Settings:
    state_filter, preprocess = rp.StateVariableFilter(cutoff=50.0), rp.Preprocess()
    u, y = next(chunks(structure, 5_000, 1))
    scaling = rp.Scaling.from_record(y, regressors(structure, DT, state_filter, preprocess, u, y)[0])
    buffer = REPLAY if replay else None
    return Settings(structure, DT, state_filter, scaling, optimizer, buffer, False, True, preprocess, 1)


def chunks(structure: rp.Structure, size: int, count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the chunks of a record: a stable plant under random steps, and noise."""
    generator = np.random.default_rng(7)
    poles = -np.geomspace(5.0, 50.0, structure.poles)
    plant = rp.TransferFunction([np.prod(-poles)], np.poly(poles))
    u = np.repeat(generator.choice([-1.0, 1.0], size * count // 20 + 1), 20)[: size * count]
    y = plant.simulate(u, dt=DT) + 0.01 * generator.standard_normal(u.size)
    for k in range(0, u.size, size):
        yield u[k : k + size], y[k : k + size]


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference relative to the largest magnitude; what is infinite must be so in both."""
    finite = np.isfinite(b)
    if not np.array_equal(a[~finite], b[~finite]):
        return math.inf
    return float(np.abs(a[finite] - b[finite]).max() / np.abs(b[finite]).max())


# --- showing


def as_table(results: Sequence[Result], limit: float) -> Table:
    table = Table(title="Kernels and C: ns a sample, ns an update (with replay: 20 a sample)", box=box.MARKDOWN)
    table.add_column("optimizer")
    for column in (
        "P",
        "sample",
        "C",
        "ratio",
        "quartiles",
        "with replay: sample",
        "update",
        "C",
        "ratio",
        "quartiles",
    ):
        table.add_column(column, justify="right")
    alone, replayed = ([result for result in results if result.replay is replay] for replay in (False, True))
    for one, many in zip(alone, replayed, strict=True):
        table.add_row(
            one.optimizer,
            str(one.entries),
            f"{one.sample:.1f}",
            f"{one.sample_c:.1f}",
            *as_ratio(one, limit),
            f"{many.sample:.0f}",
            f"{many.update:.1f}",
            f"{many.update_c:.1f}",
            *as_ratio(many, limit),
        )
    return table


def as_ratio(result: Result, limit: float) -> tuple[str, str]:
    low, high = result.ratio_quartiles
    ratio = f"{result.ratio:.2f}"
    return (f"[bold red]{ratio}[/]" if result.ratio > limit else ratio), f"{low:.2f}..{high:.2f}"


def describe_machine(flags: str) -> dict[str, str]:
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = models[0].split(":", 1)[1].strip() if models else cpu
    version = subprocess.run(["gcc", "-dumpfullversion"], capture_output=True, text=True, check=True).stdout.strip()
    return {
        "CPU": f"{cpu}, {os.cpu_count()} cores",
        "Python": f"{platform.python_version()}, NumPy {np.__version__}",
        "gcc": f"{version}, {flags}",
    }


if __name__ == "__main__":
    sys.exit(main())
