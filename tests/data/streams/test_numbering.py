"""Sequence numbers: no sample twice, each lost one counted, a reset device believed where nothing is resent."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replant.data.streams.batch import Batch
from replant.data.streams.numbering import MISORDER, Numbering


def batch_of(numbers: list[int]) -> Batch:
    values = np.array(numbers, dtype=float)
    return Batch(values, -values, values / 10, np.array(numbers, dtype=np.int64), arrived=1.0)


def screen(numbering: Numbering, *batches: list[int]) -> list[int]:
    kept: list[int] = []
    for numbers in batches:
        batch = numbering.screen(batch_of(numbers))
        assert batch.sequence is not None
        assert batch.t is not None
        assert batch.u.tolist() == (-batch.y).tolist() == batch.sequence.tolist() == (batch.t * 10).tolist()
        kept += batch.sequence.tolist()
    return kept


@pytest.mark.parametrize("replays", [True, False])
def test_late_and_repeated_samples_are_dropped_and_gaps_counted(replays: bool) -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    assert screen(numbering, [5, 6, 7], [7, 8, 8, 11], [10, 9, 12], [12], [13]) == [5, 6, 7, 8, 11, 12, 13]
    assert counters == {"duplicate": 5, "lost": 2}
    assert numbering.last == 13


@pytest.mark.parametrize("replays", [True, False])
@settings(derandomize=True, max_examples=200, deadline=None)
@given(batches=st.lists(st.lists(st.integers(0, 40), max_size=12), max_size=6), last=st.none() | st.integers(0, 40))
def test_samples_add_up_and_go_on(replays: bool, batches: list[list[int]], last: int | None) -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=replays)
    numbering.last = last
    kept = screen(numbering, *batches)
    assert len(kept) + counters["duplicate"] == sum(map(len, batches))
    assert sorted(set(kept)) == kept
    if kept:
        start = kept[0] - 1 if last is None else last
        assert kept[0] > start
        assert counters["lost"] == kept[-1] - start - len(kept)


def test_where_things_are_sent_again_an_old_number_is_never_taken() -> None:
    """A peer that begins from zero again is read without effect until it gets past what was taken."""
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=True)
    numbering.last = 10_000
    assert screen(numbering, *([[k, k + 1] for k in range(0, 10_004, 2)])) == [10_001, 10_002, 10_003]
    assert counters == {"duplicate": 10_001}


def test_a_device_that_was_reset_is_believed_after_two_samples() -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=False)
    numbering.last = 10_000
    assert screen(numbering, [0], [1], [2, 3], [5]) == [1, 2, 3, 5]
    assert counters == {"duplicate": 1, "restarts": 1, "lost": 1}


def test_a_misread_number_far_ahead_does_not_end_the_stream() -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=False)
    assert screen(numbering, [1, 2, 900_000, 4, 5, 6]) == [1, 2, 900_000, 5, 6]
    assert counters["restarts"] == 1


def test_a_few_late_packets_in_order_are_no_restart() -> None:
    counters: Counter[str] = Counter()
    numbering = Numbering(counters, replays=False)
    numbering.last = MISORDER
    assert screen(numbering, [3, 4, 5, 6]) == []
    assert counters == {"duplicate": 4}


def test_without_numbers_everything_is_kept() -> None:
    numbering = Numbering(Counter(), replays=True)
    batch = Batch(np.ones(2), np.ones(2), None, None, 0.0)
    assert numbering.screen(batch) is batch
    assert numbering.last is None
