"""What every test shares: where the recorded logs lie, and kernels that are compiled."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]


# idle BLAS threads spin: on matrices as small as ours, with a worker a core, they cost several times the work itself
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# the same examples every time, and no opinion on how long one takes: no test depends on the machine's speed
settings.register_profile("whole", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("part", settings.get_profile("whole"), max_examples=25)


def pytest_configure(config: pytest.Config) -> None:
    """Try all examples of a property in `make slow`, a quarter of them in `make test`: see `support.cases.examples`."""
    settings.load_profile("whole" if "hypothesis" in config.option.markexpr else "part")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels where they have changed, before workers of pytest-xdist do it all at once."""
    if not hasattr(session.config, "workerinput"):
        from replant.kernels.native import library

        library()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage among what modules hold: all of it stays, and each search would go through all of it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session")
def datasets() -> Path:
    """Return the folder of recorded logs: $REPLANT_DATA, or ../shared/datasets beside the project."""
    folder = Path(os.environ.get("REPLANT_DATA", ROOT.parent / "shared" / "datasets"))
    if not folder.is_dir():
        pytest.skip(f"no recorded logs at {folder}: set REPLANT_DATA to their folder")
    return folder


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the rendering of pictures out, most of what a report costs: for tests that read its words and data."""
    from matplotlib.figure import Figure

    def savefig(_: Figure, file: Any, **options: Any) -> None:
        if options.get("format") == "svg":
            file.write('<svg width="9pt" height="9pt" viewBox="0 0 9 9"></svg>')
        else:
            Path(file).write_bytes(b"\x89PNG\r\n\x1a\n")

    monkeypatch.setattr(Figure, "savefig", savefig)
