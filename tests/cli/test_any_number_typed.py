"""Numbers that nobody expects on the command line: a result, or exit code 2 and one line."""

from __future__ import annotations

from collections import Counter

from fuzz.commands import trial

TRIES = 40  # `python -m fuzz --what commands` takes as many as one likes


def test_command_lines_with_hostile_numbers() -> None:
    outcomes = Counter(trial(number) for number in range(TRIES))  # raises FindingError with what happened
    assert outcomes["refused"] > TRIES / 4
    assert outcomes["result"] > 0
