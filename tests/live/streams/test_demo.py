"""The simulated rig is that of `replant.rigs`: endless, reproducible, and able to start from any number."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from replant.errors import InvalidArgumentError
from replant.live.streams import Batch, demo, open_source
from replant.live.streams.demo import BLOCK, simulated
from replant.rigs import deap_rig
from support.cases import every
from support.wires import Reading, wait_until

FIELDS = ("u", "y", "t", "sequence")


def first(count: int, seek: int | None = None, url: str = "demo?speed=max") -> list[np.ndarray]:
    """The first samples of a demo, as columns of `FIELDS`."""
    source = open_source(url)
    if seek is not None:
        source.seek(seek)
    batches: list[Batch] = []
    for batch in source.batches():
        if len(batch):
            batches.append(batch)
        if sum(map(len, batches)) >= count:
            break
    source.close()
    return [np.concatenate([getattr(batch, field) for batch in batches])[:count] for field in FIELDS]


def test_it_is_the_rig_without_a_seam_between_blocks() -> None:
    u, y, t, sequence = first(2 * BLOCK + 5000)
    rig = deap_rig(noise=0.0)
    noise = y - rig.measure(u)
    assert abs(noise).max() < 7e-3
    assert noise.std() == pytest.approx(1e-3, rel=0.02)  # of 136,000: seven standard deviations of the estimate
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.0, abs=0.02)
    assert sequence.tolist() == list(range(u.size))
    assert np.array_equal(t, sequence * 1e-3)
    assert (u.min() >= 2.0, u.max() <= 5.5) == (True, True)


def test_blocks_join_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without noise: what the slow mode remembers from one block to the next is below the noise."""
    monkeypatch.setattr(demo, "deap_rig", lambda: deap_rig(noise=0.0))
    _, u, y = zip(*itertools.islice(simulated(0), 3), strict=True)
    assert np.allclose(np.concatenate(y), deap_rig(noise=0.0).measure(np.concatenate(u)), rtol=0.0, atol=1e-9)


@every("after", [-1, 0, 99, BLOCK - 1, BLOCK + 77])
def test_it_goes_on_after_any_number_to_the_bit(after: int) -> None:
    whole = first(BLOCK + 300)
    for all_of_it, later in zip(whole, first(200, seek=after), strict=True):
        assert np.array_equal(later, all_of_it[after + 1 : after + 201])


def test_seeds_and_blocks_differ() -> None:
    blocks = [block for seed in (0, 1) for block in itertools.islice(simulated(seed), 2)]
    for (_, u, y), (_, other_u, other_y) in itertools.combinations(blocks, 2):
        assert not np.array_equal(u, other_u)
        assert abs(np.corrcoef(np.diff(y, 3), np.diff(other_y, 3))[0, 1]) < 0.1


def test_samples_never_come_before_their_time(read: Callable[..., Reading]) -> None:
    begun = time.monotonic()
    reading = read(open_source("demo?seed=3"))
    reading.wait_for(50)
    reading.stop()
    samples = reading.column("sequence")
    assert samples.tolist() == list(range(samples.size))
    assert samples[-1] * 1e-3 <= reading.batches[-1].arrived - begun  # never early
    assert reading.source.counters == {}


def test_a_full_queue_makes_the_simulation_wait_until_nobody_takes_any_more() -> None:
    source = open_source("demo?speed=max")
    batches = source.batches()
    assert sum(len(batch) for batch in itertools.islice(batches, 50)) > 0
    wait_until(lambda: len(source._inbox) == source._inbox._capacity, "the queue is full")
    batches.close()
    assert not [thread for thread in threading.enumerate() if "demo" in thread.name]
    assert source.counters == {}


@every("options", ["speed=-1", "seed=x", "seed=-1", "noise=1", "speed="])
def test_wrong_options_are_refused(options: str) -> None:
    with pytest.raises(InvalidArgumentError, match=r"^demo"):
        open_source(f"demo?{options}")
