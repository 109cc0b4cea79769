"""Speed of ensembles: updates/s against the number of members and of threads, beside one identifier in the same run.

One identifier and every ensemble take chunks of as many samples, in turn; a ratio is the median, over the repetitions,
of their rates in the same turn, so that what else the machine does hardly counts.  Times on one thread are processor
times of the thread.  Several threads are compared with one by the clock, which counts for something only on an idle
machine: beside it stand how many processors the process had meanwhile, and its processor time on one thread by that on
several, which is 1 where the threads do not hinder each other.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import default_ensembles
import replant as rp
from kernels import ROUNDS

STRUCTURE, DT = rp.Structure(poles=2, zeros=1), 1e-3
MEMBERS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024)
OPTIMIZERS = {
    "Gradient": rp.Gradient(gain=2.0),
    "Adam": rp.Adam(step_size=1e-3),
    "AMSGrad": rp.AMSGrad(step_size=1e-3),
    "IntegralCost": rp.IntegralCost(gain=2.0, forgetting_rate=0.1),
}
BATCH, CAPACITY = 10, 5000  # those of the article's tables
PROMISED_THREADS = 1.8  # times the rate of one thread, on two
PROMISED, PROMISED_MEMBERS = 3.5, 64  # times the rate of one stream, on one thread
CHUNK = 2000  # samples of each stream in one call: two seconds
TASK = 2_000_000  # updates timed at once, at least: most rows of the buffers are then read more than once

Clock = Callable[[], np.ndarray]
Times = np.ndarray


@dataclass(frozen=True)
class Rate:
    """One ensemble beside one identifier.

    Attributes
    ----------
    optimizer : str
    buffer : str
        "none"; "one seed": the members draw the same rows; "own seeds".
    members, threads : int
    updates_per_second : float
        Of all members together.
    ratio : float
        To one identifier on one thread; of several threads, to the same ensemble on one.
    quartiles : tuple of float
    processors : float
        How many the process had, on the mean: of several threads alone.
    efficiency : float
        Processor time on one thread by that on several.
    """

    optimizer: str
    buffer: str
    members: int
    threads: int
    updates_per_second: float
    ratio: float
    quartiles: tuple[float, float]
    processors: float = 1.0
    efficiency: float = 1.0


def measure(members: Sequence[int] = MEMBERS, repetitions: int = 15) -> dict[str, object]:
    """Return all rates: {"one_thread": [...], "threads": [...]}, medians over `ROUNDS` through them all."""
    alone = [
        (name, buffer, number)
        for name in OPTIMIZERS
        for buffer in ("none", "one seed", "own seeds")
        for number in (members if name == "AMSGrad" else [PROMISED_MEMBERS])
    ]
    several = [
        (buffer, count) for buffer in ("none", "one seed", "own seeds") for count in range(2, (os.cpu_count() or 1) + 1)
    ]
    one_thread: dict[Any, list[Times]] = {case: [] for case in alone}
    threads: dict[Any, list[Times]] = {case: [] for case in several}
    for _ in range(ROUNDS):
        for case in alone:
            times = repetitions if case[2] <= PROMISED_MEMBERS else max(repetitions // 3, 3)
            one_thread[case].append(beside_one(*case, -(-times // ROUNDS)))
        for case in several:
            threads[case].append(beside_one_thread(*case, -(-repetitions // ROUNDS)))
    rates = [rate_of(*case, np.concatenate(times)) for case, times in one_thread.items()]
    shared = [rate_of_threads(*case, np.concatenate(times)) for case, times in threads.items()]
    vectors = [rate for rate in rates if rate.members == PROMISED_MEMBERS and rate.buffer != "own seeds"]
    holds = all(rate.ratio >= PROMISED for rate in vectors) and all(rate.ratio >= PROMISED_THREADS for rate in shared)
    default = default_ensembles.measure()
    return {
        "holds": holds and default["holds"],
        "default": default,
        "promised": {"members": PROMISED_MEMBERS, "ratio": PROMISED},
        "one_thread": [asdict(rate) for rate in rates],
        "threads": [asdict(rate) for rate in shared],
    }


def identifiers(optimizer: str, buffer: str, members: int) -> list[rp.Identifier]:
    """Return the members, before their first sample."""
    seeds = range(members) if buffer == "own seeds" else [0] * members
    replays = [None if buffer == "none" else rp.Replay(CAPACITY, BATCH, seed=seed) for seed in seeds]
    lowpass = rp.StateVariableFilter(cutoff=50.0)
    return [
        rp.Identifier(
            STRUCTURE, DT, filter=lowpass, scaling=None, optimizer=OPTIMIZERS[optimizer], replay=replay,
            instruments=False,
        )
        for replay in replays
    ]  # fmt: skip


def streams(members: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return input and output (samples, members): noise, of which every member makes the same effort."""
    generator = np.random.default_rng(7)
    u = generator.choice([-1.0, 1.0], (samples // 20 + 1, members)).repeat(20, axis=0)[:samples]
    return u, 0.1 * generator.standard_normal((samples, members))


def beside_one(optimizer: str, buffer: str, members: int, repetitions: int) -> Times:
    """Time an ensemble on one thread and one identifier, in turn: (repetitions, 2), ns a sample of a member."""
    updates = 1 if buffer == "none" else BATCH
    one, ensemble = identifiers(optimizer, buffer, 1)[0], rp.Ensemble(identifiers(optimizer, buffer, members))
    u, y = streams(members, CHUNK)
    own_u, own_y = u[:, 0].copy(), y[:, 0].copy()
    for _ in range(-(-CAPACITY // CHUNK)):  # the buffers are full then: the draws are spread over all of their memory
        one.update_many(own_u, own_y)
        ensemble.update_many(u, y)
    times = []
    for _ in range(repetitions):
        mine = time_a_sample(lambda: one.update_many(own_u, own_y), -(-TASK // (updates * CHUNK)))
        theirs = time_a_sample(lambda: ensemble.update_many(u, y), -(-TASK // (updates * CHUNK * members)))
        times.append((mine, theirs / members))
    return np.array(times)


def rate_of(optimizer: str, buffer: str, members: int, times: Times) -> Rate:
    """Return the medians of what `beside_one` has timed."""
    updates = 1 if buffer == "none" else BATCH
    low, ratio, high = quotient(times[:, 0], times[:, 1])
    return Rate(optimizer, buffer, members, 1, updates * 1e9 / float(np.median(times[:, 1])), ratio, (low, high))


def beside_one_thread(buffer: str, threads: int, repetitions: int) -> Times:
    """Time an ensemble of AMSGrad on one thread and on several, in turn: (repetitions, 4), ns a sample of a member.

    By the clock and of processor time on one thread, then on several.
    """
    updates, members = 1 if buffer == "none" else BATCH, PROMISED_MEMBERS
    samples = 2 * TASK // (updates * members)  # so many that starting the threads does not count
    pair = [rp.Ensemble(identifiers("AMSGrad", buffer, members), n_jobs=count) for count in (1, threads)]
    u, y = streams(members, samples)
    for ensemble in pair:
        for _ in range(-(-CAPACITY // samples)):
            ensemble.update_many(u, y)
    turns = [
        [timed(lambda each=each: each.update_many(u, y), both_clocks) for each in pair] for _ in range(repetitions)
    ]
    return np.array(turns).reshape(repetitions, 4) / (samples * members)


def rate_of_threads(buffer: str, threads: int, times: Times) -> Rate:
    """Return the medians of what `beside_one_thread` has timed."""
    updates, (clock_one, processor_one, clock, processor) = 1 if buffer == "none" else BATCH, times.T
    low, ratio, high = quotient(clock_one, clock)
    return Rate(
        "AMSGrad", buffer, PROMISED_MEMBERS, threads, updates * 1e9 / float(np.median(clock)), ratio, (low, high),
        quotient(processor, clock)[1], quotient(processor_one, processor)[1],
    )  # fmt: skip


def time_a_sample(chunk: Callable[[], object], times: int) -> float:
    """Return how long a sample takes the thread, in ns, of so many chunks."""

    def all_chunks() -> None:
        for _ in range(times):
            chunk()

    return float(timed(all_chunks, thread_clock)[0]) / (times * CHUNK)


def timed(task: Callable[[], object], clock: Clock) -> np.ndarray:
    """Return how far the clock, or each of several, went on during the task, in ns."""
    start = clock()
    task()
    return clock() - start


def thread_clock() -> np.ndarray:
    return np.array([time.thread_time_ns()])


def both_clocks() -> np.ndarray:
    return np.array([time.perf_counter_ns(), time.process_time_ns()])


def quotient(first: Times, second: Times) -> list[float]:
    """Return the quartiles of the first times by the second."""
    return np.percentile(first / second, [25, 50, 75]).tolist()


def tables(result: dict[str, object]) -> list[Table]:
    """Return the rates as Markdown."""
    alone = Table(title="Ensembles on one thread, beside one identifier", box=box.MARKDOWN)
    several = Table(title=f"{PROMISED_MEMBERS} members on several threads, beside one thread", box=box.MARKDOWN)
    for table, key in ((alone, "one_thread"), (several, "threads")):
        columns = ["optimizer", "buffer", "members", "threads", "million updates/s", "ratio", "quartiles"]
        for column in [*columns, "processors", "efficiency"] if key == "threads" else columns:
            table.add_column(column, justify="left" if column in ("optimizer", "buffer") else "right")
        for each in result[key]:  # type: ignore[attr-defined]
            low, high = each["quartiles"]
            cells = [each["optimizer"], each["buffer"], str(each["members"]), str(each["threads"])]
            cells += [f"{each['updates_per_second'] / 1e6:.1f}", f"{each['ratio']:.2f}", f"{low:.2f}..{high:.2f}"]
            table.add_row(
                *cells, *([f"{each['processors']:.2f}", f"{each['efficiency']:.2f}"] if key == "threads" else [])
            )
    return [alone, several]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, nargs="+", default=MEMBERS, metavar="M")
    parser.add_argument("--repetitions", type=int, default=15, metavar="N", help="default: %(default)s")
    parser.add_argument("--json", type=Path, metavar="PATH", help="write the figures there as well")
    options = parser.parse_args()
    result = measure(options.members, options.repetitions)
    console = Console(width=120)
    for table in tables(result):
        console.print(table)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
