"""What every test shares: where the recorded logs lie, and kernels that are never stale."""

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]


def _kernel_cache() -> str:
    """Return a cache folder named after the kernels' source.

    Numba's cache looks at the file of the compiled function alone, so an edit of an imported kernel would go unseen.
    """
    digest = hashlib.sha256()
    for path in sorted((ROOT / "src/replant/kernels").rglob("*.py")):
        digest.update(path.read_bytes())
    return str(Path(tempfile.gettempdir()) / f"replant-kernels-{os.getuid()}-{digest.hexdigest()[:16]}")


os.environ.setdefault("NUMBA_CACHE_DIR", _kernel_cache())
# idle BLAS threads spin: on matrices as small as ours, with a worker a core, they cost several times the work itself
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# the same examples every time, and no opinion on how long one takes: no test depends on the machine's speed
settings.register_profile("replant", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("replant")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the large kernels once, where workers of pytest-xdist follow: each would do it at the same time."""
    if hasattr(session.config, "workerinput") or not getattr(session.config.option, "numprocesses", None):
        return
    program = Path(__file__).parent / "support" / "compiling.py"
    halves = [subprocess.Popen([sys.executable, program, half]) for half in ("refined", "first-order")]
    codes = [half.wait() for half in halves]
    if any(codes):
        pytest.exit(f"{program} failed", returncode=1)


@pytest.fixture(scope="session")
def datasets() -> Path:
    """Return the folder of recorded logs: $REPLANT_DATA, or ../shared/datasets beside the project."""
    folder = Path(os.environ.get("REPLANT_DATA", ROOT.parent / "shared" / "datasets"))
    if not folder.is_dir():
        pytest.skip(f"no recorded logs at {folder}: set REPLANT_DATA to their folder")
    return folder
