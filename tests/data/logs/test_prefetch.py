"""Jobs ahead of their use: a generator that is given up waits for nothing, wherever it ends."""

from __future__ import annotations

import subprocess
import sys
import threading
from functools import partial

import pytest

from replant.data.logs.table import prefetch
from support.waiting import PATIENCE, wait_until

ABANDONED = """
import faulthandler, gc
from replant.data.logs.table import prefetch
faulthandler.dump_traceback_later(PATIENCE, exit=True)

def refused():  # as a reader of the results does: the error's traceback keeps the frames, and the frames the error
    try:
        for value in prefetch((lambda: {"a": []} for _ in range(20)), 2):
            raise ValueError
    except ValueError as error:
        kept = error

gc.set_threshold(1, 1, 1)
for _ in range(500):
    refused()
"""


def test_the_results_come_in_their_order() -> None:
    assert list(prefetch((partial(pow, k, 2) for k in range(50)), 3)) == [k * k for k in range(50)]


def test_an_error_of_a_job_comes_in_its_place() -> None:
    results = prefetch((partial(divmod, 6, k) for k in (2, 1, 0, 3)), 2)
    assert [next(results), next(results)] == [(3, 0), (6, 0)]
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_what_is_given_up_neither_waits_for_its_jobs_nor_begins_others() -> None:
    free, done = threading.Event(), []

    def job(number: int) -> None:
        if number:
            free.wait()
        done.append(number)

    results = prefetch((partial(job, k) for k in range(9)), 2)
    next(results)
    giving_up = threading.Thread(target=results.close)
    giving_up.start()
    giving_up.join(PATIENCE)
    waited = giving_up.is_alive()
    free.set()
    assert not waited
    wait_until(lambda: not any(thread.name.startswith("replant-read") for thread in threading.enumerate()))
    assert set(done) <= {0, 1, 2}


def test_generators_left_to_the_garbage_collector_end_in_any_thread() -> None:
    """The collector may run while a thread of the next pool starts, and holds the locks of `threading`."""
    code = ABANDONED.replace("PATIENCE", str(PATIENCE))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
