"""A few of the mutants that `make fuzz` takes by the thousand: refused by one line, or alive as any identifier."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.trial import FindingError, Zones, narrow_trial, trial
from support.builders import identifier
from support.cases import every

PORTIONS, EACH = 10, 5  # `make fuzz` tries thousands


@every("portion", range(PORTIONS))
def test_mutants_of_checkpoints(portion: int) -> None:
    outcomes = [trial(number) for number in range(portion * EACH, portion * EACH + EACH)]
    assert set(outcomes) <= {"accepted", "refused"}


def test_mutants_are_of_both_kinds() -> None:
    """What refuses all, or accepts all, tries nothing."""
    outcomes = [trial(number) for number in range(20)]
    assert 3 <= outcomes.count("accepted") <= 17


def test_structures_of_narrow_numbers() -> None:
    assert {narrow_trial(number) for number in range(100)} <= {"accepted", "refused"}


def test_mutants_in_plain_python() -> None:
    """Each index is looked at there: one outside of its array is an error."""
    command = [sys.executable, "-m", "fuzz", "--what", "plainly", "--worker", "0", "10"]
    done = subprocess.run(
        command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=600, check=True
    )
    assert set(done.stdout.split("\n")) == {"accepted", "refused", ""}


def test_guard_zones_tell_what_is_written_beside_an_array() -> None:
    ident = identifier()
    zones = Zones.of(ident)
    zones.check()
    ident.update_many([1.0, 2.0], [0.0, 1.0])
    zones.check()
    zones.around[1][-4096] = 1.0  # the first number behind
    with pytest.raises(FindingError, match="written beside"):
        zones.check()
