"""The parser process: however it ends, the user gets one line, and the user's process continues."""

from __future__ import annotations

import gc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import parser_process, read_columns, read_log
from support.cases import every

U = np.arange(200_000.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    import scipy.io

    scipy.io.savemat(tmp_path / "log.mat", {"u": U, "y": U + 1.0})
    return tmp_path / "log.mat"


FATES = {
    "os.abort()": r"the file is damaged: SciPy's reader crashed on it \(SIGABRT\); save it again in MATLAB",
    "os.kill(os.getpid(), signal.SIGSEGV)": r"the file is damaged: SciPy's reader crashed on it \(SIGSEGV\)",
    "os.kill(os.getpid(), signal.SIGKILL)": r"the process that reads it was ended \(SIGKILL\); free some memory",
    "os.kill(os.getpid(), signal.SIGXCPU)": "reading it takes more processor time than its samples justify",
    "sys.exit(3)": r"the process that reads it was ended \(code 3\)",
    "print('[1'); os.abort()": r"the file is damaged",
    "print('garbage'); sys.exit(0)": r"the process that reads it was ended \(code 0\); free some memory",
}


@every(("fate", "message"), FATES.items(), ids=FATES)
def test_however_the_process_ends_it_is_one_line(
    path: Path, monkeypatch: pytest.MonkeyPatch, fate: str, message: str
) -> None:
    monkeypatch.setattr(parser_process, "BEGIN", f"import os, signal, sys\n{fate}")
    with pytest.raises(LogError, match=message) as caught:
        read_columns(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


ERRORS = {
    "KeyError('why')": r"not readable as a MATLAB file \('?why'?\); save it again in MATLAB",
    "LogError(f'{path}: so')": "so$",
    "OSError(errno.EIO, 'an error of the disk')": r"cannot be read \(.*disk.*\); check the path",
}


@every(("error", "message"), ERRORS.items(), ids=ERRORS)
def test_an_error_of_the_process_is_one_line(
    path: Path, monkeypatch: pytest.MonkeyPatch, error: str, message: str
) -> None:
    fails = f"import errno\nfrom replant.errors import LogError\ndef fails(path): raise {error}"
    begin = parser_process.BEGIN.removesuffix("main()")
    monkeypatch.setattr(
        parser_process, "BEGIN", f"{begin}\n{fails}\nfrom replant.logs import hdf5\nhdf5.read_matlab = fails\nmain()"
    )
    with pytest.raises(LogError, match=message) as caught:
        read_columns(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_process_that_waits_is_ended(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parser_process, "BEGIN", "import time; time.sleep(3600)")
    monkeypatch.setattr(parser_process, "STILL", 0.2)
    monkeypatch.setattr(parser_process, "STILL_PER_BYTE", 0.0)
    with pytest.raises(LogError, match=r"log\.mat: the file is damaged: reading it takes over .* s; save it again"):
        read_columns(path)


def test_an_interpreter_that_does_not_start_is_said(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(path.parent / "python"))
    with pytest.raises(LogError, match=r"log\.mat: a MATLAB file is read by a second Python, .*python did not start"):
        read_columns(path)


def test_a_script_without_a_guard_may_read_a_file(path: Path) -> None:
    """The parser process does not run the script again, and no module next to the script hides one of Python's."""
    (path.parent / "script.py").write_text(
        f"import replant as rp\nprint(len(rp.read_log({str(path)!r}, input=0, output=1, dt=1)))"
    )
    (path.parent / "unittest.py").write_text("print('not the one that SciPy imports')")
    run = subprocess.run(
        [sys.executable, "script.py"], cwd=path.parent, capture_output=True, text=True, timeout=300, check=True
    )
    assert run.stdout == f"{U.size}\n"


def test_two_passes_at_once_and_one_that_is_left(tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    pq.write_table(pa.table({"u": U, "y": U + 1.0}), tmp_path / "log.parquet")
    table = read_columns(tmp_path / "log.parquet")
    one, other = table.stream(["u"]), table.stream(["y"])
    first, second = next(one)[0], next(other)[0]
    np.testing.assert_array_equal(first + 1.0, second)
    one.close()
    np.testing.assert_array_equal(np.concatenate([second, *(block for (block,) in other)]), U + 1.0)
    np.testing.assert_array_equal(table.column("u"), U)
    table.find("u")
    del table, one, other
    gc.collect()


def test_what_the_caller_cannot_import_the_process_does_not_either(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.io", None)
    with pytest.raises(LogError, match=r"scipy\.io"):
        read_log(path, input="u", output="y", dt=1.0)


def test_the_process_that_reads_parquet_imports_no_pandas(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a short file, pandas would take most of the memory and of the time."""
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    pq.write_table(pa.table({"u": U, "y": [*U[1:], None]}), tmp_path / "log.parquet")
    (tmp_path / "pandas.py").write_text(f"import pathlib; pathlib.Path({str(tmp_path / 'imported')!r}).touch()")
    begin = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {parser_process.BEGIN}"
    monkeypatch.setattr(parser_process, "BEGIN", begin)
    np.testing.assert_array_equal(read_columns(tmp_path / "log.parquet").column("y"), [*U[1:], np.nan])
    dates = pa.array(np.arange(3), pa.timestamp("s"))
    pq.write_table(pa.table({"t": dates, "y": [1.0, 2.0, 3.0]}), tmp_path / "log.parquet")
    assert read_columns(tmp_path / "log.parquet").column("t").tolist() == [0.0, 1.0, 2.0]
    assert not (tmp_path / "imported").exists()
