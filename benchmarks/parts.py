"""Speed of the default method's parts beside plain C on the same arrays (parts.c), as ratios measured in one run.

Filters with and without instruments, the noise model, the projection on a reference, recursive least squares and the
Kalman filter on parameters: each takes the same chunks of samples as its C program, in turn, and must end with the same
numbers.
"""

from __future__ import annotations

import ctypes
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import replant as rp
from compiled import compiled
from kernels import DT, FLAGS, SAME, chunks, describe_machine, distance
from replant.estimation.engine.dimensions import Dimensions
from replant.estimation.engine.state import State
from replant.estimation.optimizers import Optimizer
from replant.kernels import schema as at
from replant.kernels.filters import autoregressions, chain, reference
from replant.kernels.filters import bank as bk
from replant.kernels.native import Ints, Matrix, Reals, kernel
from replant.kernels.optimizers import covariance
from replant.kernels.schema import LAGS, StateSlots
from replant.kernels.slot_tables import Numbers

CHUNK, REPETITIONS = 2_000, 101
LIMIT = 1.25
Arrays = list[np.ndarray]
Run = Callable[[Arrays, np.ndarray, np.ndarray], None]


@dataclass(frozen=True)
class Result:
    """One part at one size; medians of times in ns a sample."""

    part: str
    entries: int
    sample: float
    sample_c: float
    ratio: float
    ratio_quartiles: tuple[float, float]
    difference: float

    @property
    def holds(self) -> bool:
        """Whether ours is quick enough, with the same numbers."""
        return self.ratio <= LIMIT and self.difference <= SAME


# --- ours, in a loop as the C programs have it


@kernel()
def run_filters(s: StateSlots, u: Reals, y: Reals, targets: Reals):
    for k in range(u.size):
        targets[k] = chain.observe(s, u[k], y[k], s.interval)


@kernel()
def run_least_squares(theta: Reals, memory: Reals, settings: Reals, buffer: Matrix, rows: Ints, direction: int):
    for k in range(buffer.shape[0]):
        rows[0] = k
        covariance.recursive_least_squares(theta, memory, settings, buffer, rows, 1, direction)


@kernel()
def run_kalman(
    theta: Reals, memory: Reals, settings: Reals, buffer: Matrix, rows: Ints, direction: int, interval: float
):  # fmt: skip
    for k in range(buffer.shape[0]):
        rows[0] = k
        covariance.kalman_tracking(theta, memory, settings, buffer, rows, 1, direction, interval)


@kernel()
def run_noise_model(s: StateSlots, rows: Matrix, errors: Reals, targets: Reals):
    T = s.entries
    for k in range(rows.shape[0]):
        for i in range(T):
            s.phi[i], s.zeta[i] = rows[k, i], rows[k, T + i]
        targets[k] = autoregressions.filter_row(T, s.noise, s.phi, s.zeta, rows[k, 2 * T])
        if s.noise.known > LAGS:
            autoregressions.add_residuals(s.noise, int(s.noise.position), s.theta, errors, 1.0)


@kernel()
def run_reference(s: StateSlots, r: Reals, u: Reals, y: Reals, explained: Reals):
    for k in range(u.size):
        reference.carry_on(s.reference.states, s.reference.pole, r[k])
        explained[k] = reference.explained(s.reference, 0)
        explained[k] += reference.explained(s.reference, 1)
        reference.learn(s, u[k], y[k])


# --- C


def compile_parts(folder: Path) -> ctypes.CDLL:
    """Build parts.c with a header of our layout."""
    names = ("DENOMINATOR", "OUTPUT", "INPUT", "MODEL", "IMPULSE", "CHANNELS", "KEPT", "MODEL_OUTPUT", "INSTRUMENT")
    table = at.StateSlots
    slots = {slot.name.upper(): slot.index for slot in (*table.integers, *table.scalars)}
    slots |= {f"AT_{block.name.upper()}": block.index for block in table.blocks}
    slots |= {"LAGS": at.LAGS, "LAGUERRE": at.LAGUERRE, "REFERENCE_SIZE": reference.SIZE}
    for part, sizes in ((at.NoiseSlots, {"T": 0}), (at.ReferenceSlots, {"L": reference.SIZE})):
        blocks = part.begins(Numbers(at.FIXED | sizes))
        places = {slot.name: slot.index for slot in part.scalars} | blocks
        slots |= {f"{part.__name__.removesuffix('Slots')}_{name}".upper(): place for name, place in places.items()}
    lines = [f"#define {name} {value}" for name, value in slots.items()]
    lines += [f"#define {name} {getattr(bk, name)}" for name in names] + [f"#define CONSTANT_CHANNEL {bk.CONSTANT}"]
    (folder / "layout.h").write_text("\n".join(lines) + "\n")
    source, library = Path(__file__).with_name("parts.c"), folder / "parts.so"
    command = ["gcc", *shlex.split(FLAGS), f"-I{folder}", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(library))


def address(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


# --- the cases


def filter_cases(C: ctypes.CDLL) -> Iterator[tuple[str, int, Arrays, Run, Run]]:
    """Filters: fixed, fixed with instruments, refined."""
    for n in (1, 2, 3, 4, 5):
        structure = rp.Structure(poles=n, zeros=n - 1)
        plant = np.poly(-np.geomspace(5.0, 50.0, n))
        fixed = rp.StateVariableFilter(cutoff=50.0)
        for part, state_filter, instruments in (
            ("filters", fixed, False),
            ("filters, instruments", fixed, True),
            ("refined filters, instruments", rp.RefinedFilter(), True),
        ):
            state = State.build(structure, DT, state_filter, instruments=instruments)
            theta = np.zeros(state.entries)
            theta[:n], theta[2 * n - 1] = plant[1:], plant[-1]
            if instruments:
                state.install(theta)
            u, y = next(chunks(structure, 10, 1))
            compiled(run_filters)(*state.arrays, u, y, np.empty(10))  # the first sample, the discretisation
            state.samples = 10

            def ours(arrays: Arrays, u: np.ndarray, y: np.ndarray) -> None:
                compiled(run_filters)(*arrays[:5], u, y, arrays[5])

            def theirs(arrays: Arrays, u: np.ndarray, y: np.ndarray) -> None:
                ints, reals, banks, _, _, targets = arrays
                C.run_filters(
                    address(ints), address(reals), address(banks), ctypes.c_int64(banks.shape[1]),
                    ctypes.c_int64(u.size), address(u), address(y), address(targets),
                )  # fmt: skip

            yield part, 2 * n, [*state.arrays, np.empty(CHUNK)], ours, theirs


def noise_model_cases(C: ctypes.CDLL) -> Iterator[tuple[str, int, Arrays, Run, Run]]:
    """The noise model of the largest order."""
    for T in (4, 6, 8, 10, 14):
        state = State.empty(Dimensions(order=1, entries=T, ring_size=1, memory_size=0, settings_size=0))
        noise, state.theta[:] = state.noise, np.linspace(1.0, 2.0, T)
        noise.order, noise.filters, noise.gain = at.LAGS, 1.0, 0.5
        noise.models[:] = np.tril(np.random.default_rng(5).uniform(-0.5, 0.5, noise.models.shape))
        noise.models[:, 0], noise.variances[:] = 1.0, np.linspace(2.0, 1.0, at.LAGS + 1)
        rows = np.random.default_rng(6).standard_normal((CHUNK, 2 * T + 1))

        def ours(arrays: Arrays, u: np.ndarray, y: np.ndarray, rows: np.ndarray = rows) -> None:
            compiled(run_noise_model)(*arrays[:5], rows, *arrays[5:])

        def theirs(arrays: Arrays, u: np.ndarray, y: np.ndarray, rows: np.ndarray = rows) -> None:
            own, errors, targets = State(*arrays[:5]), *arrays[5:]
            C.run_noise_model(
                ctypes.c_int64(own.entries), address(own.noise.reals), ctypes.c_int64(CHUNK), address(rows),
                address(own.phi), address(own.zeta), address(own.theta), address(errors), address(targets),
            )  # fmt: skip

        yield "noise model", T, [*state.arrays, np.empty(at.LAGS + 1), np.empty(CHUNK)], ours, theirs


def reference_cases(C: ctypes.CDLL) -> Iterator[tuple[str, int, Arrays, Run, Run]]:
    """The projection of input and output on a reference."""
    state = State.empty(Dimensions(order=1, entries=1, ring_size=1, has_reference=True))
    projection = state.reference
    projection.pole, projection.states[-1] = 0.9, 1.0
    projection.factors[:], projection.diagonal[:] = np.eye(reference.SIZE), 1e3
    r = np.random.default_rng(7).standard_normal(CHUNK)

    def ours(arrays: Arrays, u: np.ndarray, y: np.ndarray) -> None:
        compiled(run_reference)(*arrays[:5], r, u, y, arrays[5])

    def theirs(arrays: Arrays, u: np.ndarray, y: np.ndarray) -> None:
        own = State(*arrays[:5])
        C.run_reference(
            address(own.reference.reals), ctypes.c_int64(CHUNK), address(r), address(u), address(y),
            address(own.work), address(arrays[5]),
        )  # fmt: skip

    yield "reference", reference.SIZE, [*state.arrays, np.empty(CHUNK)], ours, theirs


def optimizer_cases(C: ctypes.CDLL) -> Iterator[tuple[str, int, Arrays, Run, Run]]:
    """Least squares without and with forgetting, and the Kalman filter, all with instruments."""
    for P in (2, 4, 6, 8, 10):
        for part, optimizer in (
            ("least squares", rp.RecursiveLeastSquares()),
            ("least squares, forgetting", rp.RecursiveLeastSquares(forgetting_factor=0.9999)),
            ("Kalman tracking", rp.KalmanTracking(1e-3)),
        ):
            yield part, P, *optimizer_case(C, optimizer, P)


def optimizer_case(C: ctypes.CDLL, optimizer: Optimizer, P: int) -> tuple[Arrays, Run, Run]:
    generator = np.random.default_rng(3)
    rows = np.zeros((CHUNK, 2 * P + 2))
    rows[:, :P] = generator.standard_normal((CHUNK, P))
    rows[:, P + 2 :] = rows[:, :P] + 0.1 * generator.standard_normal((CHUNK, P))
    rows[:, P] = rows[:, :P].sum(axis=1) + 0.1 * generator.standard_normal(CHUNK)
    rows[:, P + 1] = 1.0
    settings, drawn = optimizer.settings(DT, np.ones(P)), np.zeros(1, np.int64)
    kalman = isinstance(optimizer, rp.KalmanTracking)

    def ours(arrays: Arrays, u: np.ndarray, y: np.ndarray) -> None:
        if kalman:
            compiled(run_kalman)(*arrays, settings, rows, drawn, P + 2, DT)
        else:
            compiled(run_least_squares)(*arrays, settings, rows, drawn, P + 2)

    def theirs(arrays: Arrays, u: np.ndarray, y: np.ndarray) -> None:
        theta, memory = arrays
        call = C.run_kalman if kalman else C.run_least_squares
        call(
            ctypes.c_int64(P), address(theta), address(memory), address(settings), address(rows),
            ctypes.c_int64(CHUNK), ctypes.c_int64(P + 2), *([ctypes.c_double(DT)] if kalman else []),
        )  # fmt: skip

    return [np.zeros(P), optimizer.memory(P)], ours, theirs


# --- measuring


def compare(part: str, P: int, arrays: Arrays, ours: Run, theirs: Run) -> Result:
    """Let both take the chunks in turn, each on arrays of its own."""
    copies = [array.copy() for array in arrays]
    times = []
    for u, y in chunks(rp.Structure(poles=P // 2), CHUNK, REPETITIONS):
        begun = time.thread_time_ns()
        ours(arrays, u, y)
        middle = time.thread_time_ns()
        theirs(copies, u, y)
        times.append((middle - begun, time.thread_time_ns() - middle))
    measured = np.array(times[5:]) / CHUNK
    sample, sample_c = np.median(measured, axis=0).tolist()
    low, ratio, high = np.percentile(measured[:, 0] / measured[:, 1], [25, 50, 75]).tolist()
    difference = max(distance(a, b) for a, b in zip(arrays, copies, strict=True) if b.any())
    return Result(part, P, sample, sample_c, ratio, (low, high), difference)


def measure() -> dict[str, Any]:
    """Return the figures: ``rows``, one for each part and size."""
    with tempfile.TemporaryDirectory() as folder:
        C = compile_parts(Path(folder))
        results = [
            compare(*case)
            for case in (*filter_cases(C), *noise_model_cases(C), *reference_cases(C), *optimizer_cases(C))
        ]
    return {"rows": [asdict(result) for result in results], "holds": all(result.holds for result in results)}


if __name__ == "__main__":
    figures = measure()
    for row in figures["rows"]:
        print(row)
    print(describe_machine(FLAGS))
    sys.exit(int(not figures["holds"]))
