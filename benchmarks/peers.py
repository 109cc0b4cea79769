"""One sample at a time beside other libraries, on the same task, with the same numbers at the end.

Tasks: recursive least squares, least mean squares, and Adam and AMSGrad on twenty rows of a buffer a sample, in the
same random order.  Ours takes (u, y) and filters them itself.  The other libraries know regressors only: they get
them from the same filter as one product of a NumPy matrix and vector a sample ("from u, y"), which is the same task,
or, to see the update alone, ready made ("regressor given").  Each library and ours take the same chunks of samples in
turn; a ratio is the median, over the chunks, of processor times of the whole process.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

# one thread each: these problems are far too small for more, and times are of the whole process
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

import numpy as np

import replant as rp
from replant.estimation.solver.least_squares import regressors
from replant.kernels.optimizers.memory import draw_below
from replant.model.preprocess import Preprocess

DT = 1e-3
STRUCTURE = rp.Structure(poles=3, zeros=1)
P = STRUCTURE.size
FILTER = rp.StateVariableFilter(cutoff=50.0)
INITIAL_COVARIANCE = 1e3
GAIN = 0.02
ADAM = {"step_size": 1e-3, "beta1": 0.9, "beta2": 0.999, "epsilon": 1e-8}
REPLAY = rp.Replay(capacity=2_000, batch_size=20, warmup=20, seed=1)
CHUNKS = 25
LATE = 2.0**30  # a step so late that nothing is left of the correction of bias

SAMPLE, GIVEN = "from u, y", "regressor given"
JITTED, WHOLE = "jitted, a call a sample", "jitted, whole chunks"

Learn = Callable[[int, int], None]  # take the samples from .. to
Estimate = Callable[[], np.ndarray]


@dataclass(frozen=True)
class Task:
    """A record, its scaled regressors, and our identifier for one of the tasks.

    Attributes
    ----------
    samples : int
        In a chunk.
    rows : (K, B) array of int, or (K, 0)
        Which samples the batch of each one holds.
    """

    name: str
    u: np.ndarray
    y: np.ndarray
    phi: np.ndarray
    target: np.ndarray
    unit: np.ndarray
    identifier: rp.Identifier
    samples: int
    rows: np.ndarray
    filter: np.ndarray

    def regressors(self, start: int, end: int) -> Iterator[tuple[np.ndarray, float]]:
        """Yield scaled regressors and targets, ready made."""
        return zip(self.phi[start:end], self.target[start:end].tolist(), strict=True)

    def filtered(self) -> Callable[[int, int], Iterator[tuple[np.ndarray, float]]]:
        """Return what yields them from (u, y), by the filter as one matrix; it keeps the filter's states."""
        n = STRUCTURE.poles
        signals = np.zeros(2 * n + 4)  # states of output and input; the last output and input, the new ones

        def take(start: int, end: int) -> Iterator[tuple[np.ndarray, float]]:
            for u, y in zip(self.u[start:end].tolist(), self.y[start:end].tolist(), strict=True):
                if start == 0 and not signals.any():
                    signals[2 * n : 2 * n + 2] = y, u  # begins at rest, with what the first sample says
                    signals[2 * n + 2 :] = y, u
                    out = self.filter @ signals
                    out[: 2 * n] = 0.0
                    out[2 * n + 2 :] = [*np.zeros(P), y / self.identifier.settings.scaling.output]
                else:
                    signals[2 * n + 2] = y
                    signals[2 * n + 3] = u
                    out = self.filter @ signals
                signals[: 2 * n + 2] = out[: 2 * n + 2]
                yield out[2 * n + 2 : -1], out[-1]

        return take

    def ours(self, start: int, end: int) -> None:
        """Take samples one by one, as a control loop would."""
        update = self.identifier.update
        for u, y in zip(self.u[start:end].tolist(), self.y[start:end].tolist(), strict=True):
            update(u, y)

    def ours_whole(self, start: int, end: int) -> None:
        """Take a chunk in compiled code."""
        self.identifier.update_many(self.u[start:end], self.y[start:end])

    @property
    def estimate(self) -> np.ndarray:
        """Ours, scaled."""
        return self.identifier.parameters / self.unit


Prepare = Callable[[Task], tuple[Learn, Estimate]]


@dataclass(frozen=True)
class Peer:
    """Another library on a task: ``prepare`` returns how it takes samples and how its estimate is read."""

    task: str
    library: str
    form: str
    prepare: Prepare
    tolerance: float
    least: float  # how many times faster ours is to be


@dataclass(frozen=True)
class Row:
    """One line of the table; times in ns a sample."""

    task: str
    library: str
    form: str
    ours: float
    theirs: float
    ratio: float
    ratio_quartiles: tuple[float, float]
    difference: float
    tolerance: float
    least: float

    @property
    def holds(self) -> bool:
        """Whether ours is as much faster as it is to be, at the same result."""
        return self.ratio >= self.least and self.difference <= self.tolerance


def make_task(name: str, form: str) -> Task:
    """Return the task, nothing learned yet; its chunks are long where they are taken as a whole."""
    optimizer, replay, samples = {
        "RLS": (rp.RecursiveLeastSquares(initial_covariance=INITIAL_COVARIANCE), None, 200),
        "LMS": (rp.Gradient(gain=GAIN / DT), None, 400),
        "Adam, batch of 20": (rp.Adam(**ADAM), REPLAY, 1000 if form == WHOLE else 40),
        "AMSGrad, batch of 20": (rp.AMSGrad(**ADAM), REPLAY, 1000 if form == WHOLE else 40),
    }[name]
    u, y = signals(samples * CHUNKS)
    phi, target = regressors(STRUCTURE, DT, FILTER, Preprocess(), u, y)
    scaling = rp.Scaling.from_record(y, phi)
    sigmas = scaling.sigmas(STRUCTURE)
    identifier = rp.Identifier(
        STRUCTURE, DT, filter=FILTER, scaling=scaling, optimizer=optimizer, replay=replay, instruments=False,
        normalize=False,
    )  # fmt: skip
    scaled = np.ascontiguousarray(phi / sigmas)
    rows = rows_drawn(u.size) if replay else np.empty((u.size, 0), np.int64)
    matrix = filter_matrix(sigmas, scaling.output)
    target = target / scaling.output
    return Task(name, u, y, scaled, target, scaling.output / sigmas, identifier, samples, rows, matrix)


def filter_matrix(sigmas: np.ndarray, output: float) -> np.ndarray:
    """Return M in [states, y, u, phi, target] = M [states, last y, last u, y, u]: the exact filter of a held input."""
    n, inputs = STRUCTURE.poles, STRUCTURE.zeros + 1
    discrete = FILTER.discretize(n, DT)
    states = np.zeros((2 * n, 2 * n + 4))
    states[:n, :n] = states[n:, n : 2 * n] = discrete.transition
    states[:n, 2 * n], states[:n, 2 * n + 2] = discrete.output_taps
    states[n:, 2 * n + 1], states[n:, 2 * n + 3] = discrete.input_taps[1:]
    newest = np.eye(2 * n + 4)[2 * n + 2 :]
    signs = np.concatenate([-1 / discrete.scale, 1 / discrete.scale[n - inputs :]]) / sigmas
    phi = signs[:, None] * np.concatenate([states[:n], states[2 * n - inputs :]])
    target = (newest[0] - discrete.characteristic @ states[:n]) / output
    return np.concatenate([states, newest, phi, target[None, :]])


def signals(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """A stable plant under random steps, and noise."""
    generator = np.random.default_rng(7)
    plant = rp.TransferFunction([1000.0, 2e4], np.poly([-8.0, -20.0, -50.0]))
    u = np.repeat(generator.choice([-1.0, 1.0], samples // 20 + 1), 20)[:samples]
    y = plant.simulate(u, dt=DT)
    return u, y + 0.01 * float(y.std()) * generator.standard_normal(samples)


def rows_drawn(samples: int) -> np.ndarray:
    """Which earlier samples each batch holds: the stream of `replant.Replay`, written out."""
    rows = np.empty((samples, REPLAY.batch_size), np.int64)
    drawn = 0
    for k in range(samples):
        filled = min(k + 1, REPLAY.capacity)
        batch = REPLAY.batch_size if filled > REPLAY.warmup else 1
        oldest = k + 1 - filled
        others = [draw_below(REPLAY.seed, drawn + i, filled) for i in range(batch - 1)]
        # row r of the ring holds the newest sample that is r modulo the capacity
        rows[k, :] = -1
        rows[k, : batch - 1] = [oldest + (r - oldest) % REPLAY.capacity for r in others]
        rows[k, batch - 1] = k
        drawn += batch - 1
    return rows


# --- the others, each as its users would write it


def source(task: Task, given: bool) -> Callable[[int, int], Iterator[tuple[np.ndarray, float]]]:
    return task.regressors if given else task.filtered()


def padasip_filter(given: bool, kind: str, **settings: float) -> Prepare:
    def prepare(task: Task) -> tuple[Learn, Estimate]:
        import padasip

        model, rows = getattr(padasip.filters, kind)(n=P, w="zeros", **settings), source(task, given)

        def learn(start: int, end: int) -> None:
            for phi, target in rows(start, end):
                model.adapt(target, phi)

        return learn, lambda: model.w

    return prepare


def river_model(given: bool, make: Callable[[], Any]) -> Prepare:
    """Predict, then learn: ours returns the error of that prediction."""

    def prepare(task: Task) -> tuple[Learn, Estimate]:
        model, rows = make(), source(task, given)
        ready = [dict(enumerate(phi)) for phi in task.phi.tolist()]

        def learn(start: int, end: int) -> None:
            for k, (phi, target) in enumerate(rows(start, end), start):
                features = ready[k] if given else dict(enumerate(phi.tolist()))
                model.predict_one(features)
                model.learn_one(features, target)

        # a linear model is known by its values on the unit vectors
        return learn, lambda: np.array([model.predict_one({i: float(i == j) for i in range(P)}) for j in range(P)])

    return prepare


def river_lms() -> Any:
    from river import linear_model, optim

    # the loss is the square, not half of it
    return linear_model.LinearRegression(optimizer=optim.SGD(GAIN / 2), intercept_lr=0.0, clip_gradient=1e150)


def river_rls() -> Any:
    from river import linear_model

    return linear_model.BayesianLinearRegression(alpha=1 / INITIAL_COVARIANCE, beta=1.0)


def filterpy_kalman(given: bool) -> Prepare:
    def prepare(task: Task) -> tuple[Learn, Estimate]:
        from filterpy.kalman import KalmanFilter

        model, rows = KalmanFilter(dim_x=P, dim_z=1), source(task, given)
        model.P *= INITIAL_COVARIANCE

        def learn(start: int, end: int) -> None:
            for phi, target in rows(start, end):
                model.update(target, H=phi[None, :])

        return learn, lambda: model.x.ravel()

    return prepare


def torch_adam(amsgrad: bool) -> Prepare:
    def prepare(task: Task) -> tuple[Learn, Estimate]:
        import torch

        torch.set_num_threads(1)
        phi, target = torch.from_numpy(task.phi), torch.from_numpy(task.target)
        theta = torch.zeros(P, dtype=torch.float64)
        optimizer = torch.optim.Adam(
            [theta], lr=ADAM["step_size"], betas=(ADAM["beta1"], ADAM["beta2"]), eps=ADAM["epsilon"], amsgrad=amsgrad
        )

        if amsgrad:  # the article's has no correction of bias: that of a late step is one
            zeros = torch.zeros_like(theta)
            optimizer.state[theta] = {
                "step": torch.tensor(LATE, dtype=torch.float32), "exp_avg": zeros.clone(), "exp_avg_sq": zeros.clone(),
                "max_exp_avg_sq": zeros.clone(),
            }  # fmt: skip

        def learn(start: int, end: int) -> None:
            with torch.no_grad():  # the gradient is known: without autograd it takes half the time
                for k in range(start, end):
                    for row in task.rows[k][task.rows[k] >= 0].tolist():
                        x = phi[row]
                        theta.grad = (theta @ x - target[row]) * x
                        optimizer.step()

        return learn, theta.numpy

    return prepare


def optax_update(name: str) -> tuple[Callable[[Any, Any, Any], Any], Callable[[Any], Any]]:
    """Return one update with one row, and what it begins with."""
    import optax

    settings = {"learning_rate": ADAM["step_size"], "b1": ADAM["beta1"], "b2": ADAM["beta2"], "eps": ADAM["epsilon"]}
    optimizer = getattr(optax, name)(**settings)

    def update(carry: Any, phi: Any, target: Any) -> Any:
        theta, state = carry
        change, state = optimizer.update((theta @ phi - target) * phi, state, theta)
        return theta + change, state

    def begin(theta: Any) -> Any:
        first, *rest = optimizer.init(theta)
        if name == "amsgrad":  # as with torch
            first = first._replace(count=first.count + int(LATE))
        return theta, (first, *rest)

    return update, begin


def optax_adam(name: str, *, whole_chunk: bool) -> Prepare:
    def prepare(task: Task) -> tuple[Learn, Estimate]:
        import jax
        import jax.numpy as jnp

        jax.config.update("jax_enable_x64", True)
        update, begin = optax_update(name)
        phi, target = jnp.asarray(task.phi), jnp.asarray(task.target)

        def one(carry: Any, row: Any) -> Any:
            return update(carry, phi[row], target[row]), None

        sweep = jax.jit(lambda carry, rows: jax.lax.scan(one, carry, rows)[0])
        carry = [begin(jnp.zeros(P))]
        if whole_chunk:
            chunks = [jnp.asarray(rows[rows >= 0]) for rows in np.split(task.rows, CHUNKS)]
            for chunk in chunks:
                sweep(carry[0], chunk)  # compiles

            def learn(start: int, end: int) -> None:
                carry[0] = jax.block_until_ready(sweep(carry[0], chunks[start // (end - start)]))
        else:
            rows = [jnp.asarray(drawn[drawn >= 0]) for drawn in task.rows]  # one until the buffer is warm
            for drawn in (rows[0], rows[-1]):
                sweep(carry[0], drawn)  # compiles

            def learn(start: int, end: int) -> None:
                for k in range(start, end):
                    carry[0] = sweep(carry[0], rows[k])
                jax.block_until_ready(carry[0])

        return learn, lambda: np.asarray(carry[0][0])

    return prepare


def per_sample(task: str, library: str, make: Callable[[bool], Prepare], tolerance: float) -> list[Peer]:
    """Return the peer in both forms; the limit holds for the same task."""
    return [
        Peer(task, library, SAMPLE, make(False), tolerance, 10),
        Peer(task, library, GIVEN, make(True), tolerance, 0),
    ]


PEERS = [
    *per_sample("RLS", "padasip", lambda given: padasip_filter(given, "FilterRLS", mu=1.0, eps=1e-3), 1e-6),
    *per_sample("RLS", "river", lambda given: river_model(given, river_rls), 1e-6),
    *per_sample("RLS", "filterpy", filterpy_kalman, 1e-6),
    *per_sample("LMS", "padasip", lambda given: padasip_filter(given, "FilterLMS", mu=GAIN), 1e-9),
    *per_sample("LMS", "river", lambda given: river_model(given, river_lms), 1e-9),
    Peer("Adam, batch of 20", "torch", GIVEN, torch_adam(False), 1e-9, 10),
    Peer("Adam, batch of 20", "optax", JITTED, optax_adam("adam", whole_chunk=False), 1e-9, 2),
    Peer("Adam, batch of 20", "optax", WHOLE, optax_adam("adam", whole_chunk=True), 1e-9, 0),
    Peer("AMSGrad, batch of 20", "torch", GIVEN, torch_adam(True), 1e-9, 10),
    Peer("AMSGrad, batch of 20", "optax", JITTED, optax_adam("amsgrad", whole_chunk=False), 1e-9, 2),
    Peer("AMSGrad, batch of 20", "optax", WHOLE, optax_adam("amsgrad", whole_chunk=True), 1e-9, 0),
]


def compare(peer: Peer, task: Task) -> Row:
    """Let both take the chunks in turn."""
    learn, estimate = peer.prepare(task)
    times = []
    ours_learn = task.ours_whole if peer.form == WHOLE else task.ours
    for start in range(0, task.u.size, task.samples):
        end = start + task.samples
        begun = time.process_time_ns()
        ours_learn(start, end)
        middle = time.process_time_ns()
        learn(start, end)
        times.append((middle - begun, time.process_time_ns() - middle))
    measured = np.array(times[2:]) / task.samples  # the first ones load caches
    ours, theirs = np.median(measured, axis=0).tolist()
    low, ratio, high = np.percentile(measured[:, 1] / measured[:, 0], [25, 50, 75]).tolist()
    difference = float(np.abs(estimate() - task.estimate).max() / np.abs(task.estimate).max())
    return Row(
        peer.task, peer.library, peer.form, ours, theirs, ratio, (low, high), difference, peer.tolerance, peer.least
    )


def measure() -> dict[str, Any]:
    """Return the figures: ``rows``, one for each library and form."""
    rows = []
    for peer in PEERS:
        rows.append(compare(peer, make_task(peer.task, peer.form)))
        print(rows[-1], file=sys.stderr)
    return {"rows": [asdict(row) for row in rows], "holds": all(row.holds for row in rows)}


if __name__ == "__main__":
    sys.exit(int(not measure()["holds"]))
