"""The four tables, run once a session."""

import pytest

from replant.paper import TABLES, TableResult, reproduce


@pytest.fixture(scope="session")
def results() -> dict[str, TableResult]:
    return {name: reproduce(table) for name, table in TABLES.items()}
