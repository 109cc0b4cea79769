"""No test depends on how fast or how busy the machine is: none measures time, and limits only end a broken one."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from hypothesis import HealthCheck, settings

from support.cases import every

TESTS = Path(__file__).parent
CLOCKS = {f"{name}{end}" for name in ("perf_counter", "process_time", "thread_time") for end in ("", "_ns")}
LEAST = 60.0  # s: what stands as ``timeout=`` must be longer


def offences(tree: ast.AST) -> Iterator[str]:
    """Every use of a clock for durations, and every limit that a busy machine may reach."""
    for node in ast.walk(tree):
        name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
        if name in CLOCKS:
            yield f"line {node.lineno}: {name}: what takes how long is measured by `make bench`"
        if (
            isinstance(node, ast.keyword)
            and (node.arg or "").endswith("timeout")
            and isinstance(node.value, ast.Constant)
        ):
            limit = node.value.value
            if isinstance(limit, int | float) and limit < LEAST:
                yield f"line {node.value.lineno}: {node.arg}={limit}: take waiting.PATIENCE"


@every("path", sorted(TESTS.rglob("*.py")), ids=lambda path: str(path.relative_to(TESTS)))
def test_nothing_is_measured_and_limits_are_generous(path: Path) -> None:
    assert list(offences(ast.parse(path.read_text(encoding="utf-8")))) == []


def test_offences_are_seen() -> None:
    bad = "import time\nbegun = time.perf_counter()\nrun(timeout=30)\nconnect(open_timeout=0.5, timeout=None)\n"
    assert [offence.partition(":")[0] for offence in offences(ast.parse(bad))] == ["line 2", "line 3", "line 4"]


def test_examples_are_the_same_every_time_and_may_take_long() -> None:
    assert settings.default.deadline is None
    assert settings.default.derandomize
    assert HealthCheck.too_slow in settings.default.suppress_health_check
