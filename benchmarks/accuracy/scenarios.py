"""Every scenario by its letter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

from accuracy.controlled import scenario_k
from accuracy.experiment import Experiment
from accuracy.linear import scenario_a, scenario_b, scenario_coloured, scenario_e, scenario_f
from accuracy.rigs import scenario_c, scenario_d, scenario_i

SCENARIOS: dict[str, Callable[[], Iterator[Experiment]]] = {
    "A": scenario_a,
    "B": scenario_b,
    "C": scenario_c,
    "D": scenario_d,
    "E": scenario_e,
    "F": scenario_f,
    "I": scenario_i,
    "J": scenario_coloured,
    "K": scenario_k,
}
COVERAGE, VERDICTS = "G", "H"
#: What can be asked for; "G" is measured on the runs of A and B, "H" is in `accuracy.verdicts`.
LETTERS = tuple(sorted([*SCENARIOS, COVERAGE, VERDICTS]))


@cache
def experiments() -> dict[str, Experiment]:
    """Return every experiment by its key."""
    return {each.key: each for scenario in SCENARIOS.values() for each in scenario()}


def chosen(letters: list[str]) -> list[Experiment]:
    """Return the experiments of the scenarios asked for."""
    return [
        each for each in experiments().values() if each.scenario in letters or (COVERAGE in letters and each.covered)
    ]
