"""The four tables, and the actuator experiment on a short record, each run once a session."""

import pytest

from replant.paper.actuator import Actuator, measure_rig, reproduce_actuator
from replant.paper.tables import TABLES, TableResult, reproduce


@pytest.fixture(scope="session")
def results() -> dict[str, TableResult]:
    return {name: reproduce(table) for name, table in TABLES.items()}


@pytest.fixture(scope="session")
def actuator() -> Actuator:
    """Return the experiment on the first 2 s of the rig."""
    return reproduce_actuator(measure_rig(2_000))
