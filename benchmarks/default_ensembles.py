"""Speed of an ensemble of the default method beside one identifier in the same run: between its reviews, and with them.

An identifier looks into its record each 5,000 samples, and searches that for a change each 15,000, which takes as long
as thousands of samples; chunks are shorter: their median tells what is between, and their sum all of it.  What two
threads can reach on a machine is told by two processes, each with half of the members, that have nothing in common.
"""

from __future__ import annotations

import json
import multiprocessing
import time
from multiprocessing.synchronize import Barrier
from typing import Any

import numpy as np

import replant as rp

MEMBERS, DT, PERIOD, BEGUN = 64, 0.02, 1000, 46
PROMISED, PROMISED_THREADS = 2.5, 1.8
PLANT = rp.TransferFunction([2.0, 6.0], [1.0, 2.0, 5.0])
LEAST = 30  # chunks: two searches and four looks beside
ROUNDS = 3  # of one and two threads, one and two processes in turn, of which the least medians count


class Stream:
    """The period of a record that goes on without a seam, under new noise each time."""

    def __init__(self) -> None:
        self._generator = np.random.default_rng(7)
        self.u = np.repeat(self._generator.choice([-1.0, 1.0], PERIOD // 20), 20)
        self._clean = PLANT.simulate(np.tile(self.u, 4), DT)[-PERIOD:]

    def y(self, members: int) -> np.ndarray:
        """Return outputs (PERIOD, members)."""
        return self._clean[:, None] + 0.1 * self._generator.standard_normal((PERIOD, members))

    def identifier(self) -> rp.Identifier:
        """Return an identifier whose ring of raw samples is full."""
        one = rp.Identifier(rp.Structure(2, 1), DT)
        for _ in range(BEGUN):
            one.update_many(self.u, self.y(1)[:, 0])
        return one


def measure(repetitions: int = LEAST) -> dict[str, Any]:
    """Return ns a sample of a member: of one identifier, of the ensemble on one thread and on two; and ratios."""
    stream = Stream()
    one = stream.identifier()
    pair = [rp.Ensemble(one, MEMBERS, n_jobs=jobs) for jobs in (1, 2)]
    columns, times = np.repeat(stream.u[:, None], MEMBERS, axis=1), []
    for _ in range(ROUNDS * max(repetitions, LEAST)):
        y = stream.y(MEMBERS)
        first = np.ascontiguousarray(y[:, 0])
        times.append([timed(one, stream.u, first), *(timed(each, columns, y) for each in pair)])
    clock, processor = np.array(times).transpose(2, 1, 0) / PERIOD / np.array([[[1]], [[MEMBERS]], [[MEMBERS]]])[:, 0]
    usual = np.median(processor, axis=1)
    between = np.median(clock[1:].reshape(2, ROUNDS, -1), axis=2).min(axis=1)
    one_thread, two_threads = clock[1:].reshape(2, ROUNDS, -1).sum(axis=2).min(axis=1)  # rounds of equal reviews
    ratios = {
        "between_reviews": float(usual[0] / usual[1]),
        "with_reviews": float(processor[0].sum() / processor[1].sum()),
        "two_threads": float(one_thread / two_threads),
        "two_threads_between": float(between[0] / between[1]),
        "two_processes": two_processes(),
        "efficiency": float(usual[1] / usual[2]),
    }
    holds = ratios["with_reviews"] >= PROMISED and ratios["two_threads"] >= PROMISED_THREADS
    return {"members": MEMBERS, "one": float(usual[0]), "together": float(usual[1]), **ratios, "holds": holds}


def two_processes() -> float:
    """Return how much sooner two processes take all members than one does."""
    rounds = [(in_processes(1)[0], max(in_processes(2))) for _ in range(ROUNDS)]
    alone, both = np.min(rounds, axis=0)
    return 2.0 * float(alone / both)


def in_processes(count: int) -> list[float]:
    """Return how long half of the members take all chunks in each of so many processes at once."""
    context = multiprocessing.get_context("spawn")
    found, begun = context.SimpleQueue(), context.Barrier(count)
    each = [context.Process(target=take_half, args=(begun, found)) for _ in range(count)]
    for process in each:
        process.start()
    taken = [found.get() for _ in each]
    for process in each:
        process.join()
    return taken


def take_half(begun: Barrier, found: Any) -> None:
    """Put into ``found`` how long half of the members take all chunks."""
    stream = Stream()
    half, columns = rp.Ensemble(stream.identifier(), MEMBERS // 2), np.repeat(stream.u[:, None], MEMBERS // 2, axis=1)
    chunks = [stream.y(MEMBERS // 2) for _ in range(LEAST)]
    begun.wait()
    found.put(float(np.sum([timed(half, columns, y)[0] for y in chunks])))


def timed(taker: rp.Identifier | rp.Ensemble, u: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return how long a chunk takes, by the clock and of processor time, in ns."""
    begun = time.perf_counter_ns(), time.process_time_ns()
    taker.update_many(u, y)
    return float(time.perf_counter_ns() - begun[0]), float(time.process_time_ns() - begun[1])


if __name__ == "__main__":
    print(json.dumps(measure(), indent=2))
