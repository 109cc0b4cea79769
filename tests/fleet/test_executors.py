"""The executor does not affect results: threads, processes, Dask, any executor; nor does the death of a worker."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import loky
import psutil
import pytest

import replant as rp
from replant.errors import InvalidArgumentError, MissingDependencyError, SystemRefusedError
from replant.fleet.executors import MOST_LOST, Workers, carried_out, parsed, processes, workers
from support.cases import every
from support.dying import die_first
from support.fleets import small_fleet
from support.waiting import PATIENCE

RIGS = 12
EMPTY = 12_288  # size of the file of a fleet without a rig [bytes]


def fitted(logs: Path, out: Path, executor: object = None, **more: object) -> list[bytes]:
    rp.fleet.fit(logs, by="file", input="u", output="y", poles=2, method="fit", executor=executor, out=out, **more)
    return bytes_of(out)


def bytes_of(out: Path) -> list[bytes]:
    return [(out / name).read_bytes() for name in ("rigs.parquet", "models.jsonl")]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_fleet(tmp_path_factory.mktemp("fleet") / "logs", RIGS)


@pytest.fixture(scope="module")
def expected(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """The bytes that one thread writes."""
    return fitted(logs, tmp_path_factory.mktemp("fleet") / "out")


@contextmanager
def dask_cluster(count: int) -> Iterator:
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": ":0", "processes": True}
    with distributed.LocalCluster(**options) as cluster:
        yield cluster


@pytest.mark.slow
@every("on", ["processes:2", "threads:3", "threads:1"], quick=1)
def test_threads_and_processes_write_the_same_bytes(logs: Path, expected: list[bytes], tmp_path: Path, on: str) -> None:
    assert fitted(logs, tmp_path / "out", on) == expected


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.filterwarnings("default")  # Dask's own
def test_dask_writes_the_same_bytes(logs: Path, expected: list[bytes], tmp_path: Path, count: int) -> None:
    with dask_cluster(count) as cluster:
        address = cluster.scheduler_address.removeprefix("tcp:")
        assert fitted(logs, tmp_path / "by-address", f"dask:{address}") == expected


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_worker_of_dask_that_dies_costs_nothing_but_time(logs: Path, expected: list[bytes], tmp_path: Path) -> None:
    from distributed import Client

    with dask_cluster(2) as cluster, Client(cluster) as client:
        killed: list[int] = []

        def kill_one(state: object) -> None:
            if state.done and not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        got = fitted(logs, tmp_path / "out", client.get_executor(pure=False, retries=3), progress=kill_one)
    assert killed
    assert got == expected


@pytest.mark.slow
def test_loky_writes_the_same_bytes(logs: Path, expected: list[bytes], tmp_path: Path) -> None:
    executor = loky.ProcessPoolExecutor(2)
    try:
        assert fitted(logs, tmp_path / "out", executor) == expected
    finally:
        executor.shutdown(kill_workers=True)


def test_another_order_of_tasks_and_files_writes_the_same_bytes(
    logs: Path, expected: list[bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from replant.fleet import catalogue, worker

    walk, plan = catalogue.os.walk, worker.planned
    monkeypatch.setattr(catalogue.os, "walk", lambda top, **how: reversed(list(walk(top, **how))))
    monkeypatch.setattr(worker, "planned", lambda *args: random.Random(0).sample(tasks := plan(*args), len(tasks)))
    assert fitted(logs, tmp_path / "out") == expected


def test_an_executor_that_is_given_stays_open(logs: Path, tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as pool:
        fitted(logs, tmp_path / "out", pool)
        assert pool.submit(pow, 2, 3).result() == 8


# --- workers that die


@pytest.mark.parametrize(
    "deaths", [pytest.param(0, marks=pytest.mark.slow), 1, pytest.param(2, marks=pytest.mark.slow)]
)
def test_tasks_of_workers_that_died_are_done_by_new_ones(tmp_path: Path, deaths: int) -> None:
    tasks = [(str(tmp_path), number, deaths) for number in range(6)]
    with workers("processes:1") as found:
        done = dict(carried_out(found, die_first, tasks))
    assert done == {number: number for number in range(6)}


@pytest.mark.slow
def test_a_task_that_kills_every_worker_ends_the_run(tmp_path: Path) -> None:
    tasks = [(str(tmp_path), 0, 99)]
    with workers("processes:1") as found, pytest.raises(SystemRefusedError, match=r"died .* without a finished task"):
        list(carried_out(found, die_first, tasks))
    assert len(list(tmp_path.iterdir())) == MOST_LOST + 1


def test_dead_workers_of_the_caller_are_not_replaced(tmp_path: Path) -> None:
    with processes(1) as pool, pytest.raises(SystemRefusedError, match="restart them"):
        list(carried_out(Workers(pool), die_first, [(str(tmp_path), 0, 1)]))


def test_an_error_of_a_task_cancels_those_that_wait() -> None:
    class Patient(Executor):
        def __init__(self) -> None:
            self.waiting: list[Future] = []

        def submit(self, fn: Callable, /, *args: object, **kwargs: object) -> Future:
            future: Future = Future()
            if args[0] == 0:
                future.set_exception(ValueError("invalid literal"))
            else:
                self.waiting.append(future)
            return future

    patient = Patient()
    with pytest.raises(ValueError, match="invalid literal"):
        list(carried_out(Workers(patient), int, range(4)))
    assert [future.cancelled() for future in patient.waiting] == [True] * 3


def started(logs: Path, out: Path) -> subprocess.Popen:
    options = ["--by", "file", "-i", "u", "-o", "y", "-p", "2", "--method", "fit", "--on", "processes:2"]
    return subprocess.Popen(
        [sys.executable, "-m", "replant", "fleet", str(logs), *options, "--out", str(out)], stdout=subprocess.DEVNULL
    )


def has_rows(out: Path) -> bool:
    """Return whether a task is finished; the run locks the file, so its size is used."""
    file = out / "fleet.sqlite"
    return file.exists() and file.stat().st_size > EMPTY


def wait_for(happened: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.slow
def test_a_run_whose_coordinator_is_killed_leaves_no_worker_and_goes_on(
    logs: Path, expected: list[bytes], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = started(logs, out)
    wait_for(lambda: has_rows(out) or run.poll() is not None)
    children = psutil.Process(run.pid).children(recursive=True) if run.poll() is None else []
    run.kill()
    run.wait()
    assert not (out / "rigs.parquet").exists()
    wait_for(lambda: not any(child.is_running() and child.status() != psutil.STATUS_ZOMBIE for child in children))
    assert fitted(logs, out) == expected


@pytest.mark.slow
def test_a_run_whose_workers_are_killed_ends_with_the_same_bytes(
    logs: Path, expected: list[bytes], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = started(logs, out)
    wait_for(lambda: has_rows(out))
    for child in psutil.Process(run.pid).children(recursive=True):
        if "spawn_main" in " ".join(child.cmdline()):
            child.kill()
            break
    assert run.wait() == 0
    assert bytes_of(out) == expected


# --- how executors are named


@every(
    "on",
    ["threads", "threads:0", "threads:x", "processes:-1", "processes:none", "dask:host:1", "dask://host", "mpi:4", ""],
)
def test_an_unknown_executor_name_is_refused(on: str) -> None:
    with pytest.raises(InvalidArgumentError, match=r"is not an executor.*threads:N, processes:N or dask://HOST:PORT"):
        parsed(on)


def test_an_object_that_is_not_an_executor_is_refused() -> None:
    with pytest.raises(InvalidArgumentError, match=r"or a concurrent\.futures\.Executor, got 3"), workers(3):
        pass


def test_dask_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'replant\[cluster\]'"), workers("dask://host:8786"):
        pass


@pytest.mark.filterwarnings("default")
def test_a_scheduler_that_does_not_respond_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replant.fleet.executors.PATIENCE", 1.0)
    with (
        pytest.raises(SystemRefusedError, match=r"no Dask scheduler responds at 127\.0\.0\.1:9"),
        workers("dask://127.0.0.1:9"),
    ):
        pass


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system has no signal masks")
def test_ctrl_c_is_for_the_coordinator_alone_from_the_first_instruction_on() -> None:
    with processes(1) as pool:
        assert signal.SIGINT in pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result(PATIENCE)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_workers_use_one_thread_each_and_the_environment_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with processes(1) as pool:
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
    assert "OMP_NUM_THREADS" not in os.environ
