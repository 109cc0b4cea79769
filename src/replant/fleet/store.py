"""Store: the finished rigs of a fleet in one SQLite file, and the tables that are made of it at the end."""

from __future__ import annotations

import contextlib
import errno
import importlib.util
import json
import math
import os
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, LogError, MissingDependencyError, SystemRefusedError
from replant.fitting.miso_model import RowModel
from replant.fitting.model import Model
from replant.fleet.job import (
    ABOUT,
    MODELS,
    REPORTS,
    STORE,
    TABLE,
    TIMING,
    Job,
    Rig,
    Shape,
    digest,
    is_results,
    printable,
    replacing,
    report_path,
)
from replant.logs.arrow import CHECKED
from replant.numerics.operating_system import ENDING, refusal

CHUNK_ROWS = 1 << 14  # rows of a row group of the table [rows]
PROBE = 1 << 16  # bytes beyond the file's size that are written to find out why it cannot grow [bytes]


class Store:
    """The folder of a fleet's results; finished rigs are rows of a database, written task by task."""

    def __init__(self, folder: Path, job: Job) -> None:
        if importlib.util.find_spec("pyarrow") is None:
            raise MissingDependencyError("the results of a fleet are Parquet files: pip install 'replant[parquet]'")
        self.folder, self.job, self._key = folder.absolute(), job, job.key
        try:
            theirs = () if is_results(self.folder) else (TABLE, TIMING, MODELS, REPORTS)
            others = [name for name in theirs if (self.folder / name).exists()]
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SystemRefusedError(f"{folder} cannot be written: {refusal(error)}") from error
        if others:
            raise InvalidArgumentError(
                f"{folder}: {', '.join(others)} would be overwritten, but do not belong to a fleet; name another "
                "folder (out, --out)"
            )

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Lock the folder: two runs that write into the same folder would do the work twice."""
        with self._refusals_said():
            self._file = _opened(self.folder / STORE)
        with contextlib.closing(self._file):
            for left in self.folder.glob(f".*{ENDING}"):  # left by killed writers: others write only with the lock
                with contextlib.suppress(OSError):
                    left.unlink(missing_ok=True)
            yield

    @contextlib.contextmanager
    def _refusals_said(self) -> Iterator[None]:
        path = self.folder / STORE
        try:
            yield
        except sqlite3.Error as error:
            if _is(error, sqlite3.SQLITE_BUSY):
                raise SystemRefusedError(
                    f"{self.folder}: another run writes there; wait for its end, or name another folder"
                ) from error
            raise SystemRefusedError(f"{path} cannot be written: {_reason(path, error)}") from error

    def forget_reports(self, rigs: Sequence[Rig]) -> None:
        """Remove the reports of rigs that are identified again, as they show the old models."""
        for rig in rigs:
            with contextlib.suppress(OSError):
                (self.folder / report_path(rig.name)).unlink(missing_ok=True)

    def missing(self, rigs: Sequence[Rig]) -> list[Rig]:
        """Return the rigs without a result of the same job and files; `merge` then writes those of all ``rigs``."""
        with self._refusals_said(), self._file:
            self._file.execute("CREATE TEMP TABLE wanted (place INTEGER PRIMARY KEY, key BLOB)")
            self._file.executemany("INSERT INTO wanted VALUES (?, ?)", enumerate(map(self._key_of, rigs)))
            found = self._file.execute("SELECT place, cells FROM wanted JOIN rig USING (key)")
            done = {place for place, cells in found if _cells_in(cells) is not None}
        return [rig for place, rig in enumerate(rigs) if place not in done]

    def add(self, rigs: Sequence[Rig], results: Sequence[dict[str, Any]]) -> None:
        """Add the cells of rigs in one transaction."""
        texts = [json.dumps(cells, allow_nan=False).encode() for cells in results]
        rows = [(self._key_of(rig), zlib.compress(text, 1)) for rig, text in zip(rigs, texts, strict=True)]
        with self._refusals_said(), self._file:
            self._file.executemany("INSERT OR REPLACE INTO rig VALUES (?, ?)", rows)

    def merge(self, about: dict[str, Any]) -> None:
        """Write the table of all rigs in the order given to `missing`, their times, and the models.

        Unused results are deleted: those of other options, of changed files, and of removed rigs.
        """
        import pyarrow
        from pyarrow import parquet

        models_written = 0
        columns = schema(self.job.shape)
        seconds = pyarrow.schema([("rig", pyarrow.string()), ("seconds", pyarrow.float64())])
        with ExitStack() as files:
            table, timing, models = (
                files.enter_context(replacing(self.folder / name)) for name in (TABLE, TIMING, MODELS)
            )
            rows = files.enter_context(parquet.ParquetWriter(table, columns, **CHECKED))
            times = files.enter_context(parquet.ParquetWriter(timing, seconds, **CHECKED))
            lines = files.enter_context(models.open("w", encoding="utf-8"))
            for chunk in self._chunks():
                rows.write_table(pyarrow.Table.from_pylist(chunk, columns))
                times.write_table(pyarrow.Table.from_pylist(chunk, seconds))
                for cells in chunk:
                    if "model" in cells:
                        lines.write(f'{{"rig": {json.dumps(cells["rig"])}, "model": {cells["model"]}}}\n')
                        models_written += 1
        with replacing(self.folder / ABOUT) as new:
            new.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        if models_written:  # if there are none, an option may be wrong, and the old results are needed again
            with self._refusals_said(), self._file:
                self._file.execute("DELETE FROM rig WHERE key NOT IN (SELECT key FROM wanted)")

    def _key_of(self, rig: Rig) -> bytes:
        return digest(self._key, rig.name, rig.fingerprint).encode()

    def _chunks(self) -> Iterator[list[Any]]:
        """Yield the cells of all rigs, `CHUNK_ROWS` at a time."""
        with self._refusals_said():
            found = self._file.execute("SELECT cells FROM wanted JOIN rig USING (key) ORDER BY place")
            while chunk := found.fetchmany(CHUNK_ROWS):
                yield [_cells_in(cells) for (cells,) in chunk]


def _opened(path: Path) -> sqlite3.Connection:
    """Open and lock the database; replace a damaged one by an empty one."""
    for is_new in (False, True):
        if is_new:
            path.unlink(missing_ok=True)
        file = sqlite3.connect(path, timeout=0.0)
        file.text_factory = bytes  # in a damaged file a blob may have become text
        try:
            file.execute("PRAGMA locking_mode = EXCLUSIVE")
            file.execute("PRAGMA temp_store = MEMORY")
            file.execute("BEGIN EXCLUSIVE")
            file.execute("CREATE TABLE IF NOT EXISTS rig (key BLOB PRIMARY KEY, cells BLOB)")
            file.commit()
            if file.execute("PRAGMA quick_check(1)").fetchone() == (b"ok",) or is_new:
                return file
            file.close()
        except sqlite3.Error as error:
            file.close()
            if is_new or not (_is(error, sqlite3.SQLITE_NOTADB) or _is(error, sqlite3.SQLITE_CORRUPT)):
                raise
    raise AssertionError


def _is(error: sqlite3.Error, code: int) -> bool:
    """Return whether an error of SQLite has a primary code; extended codes have further bits."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF == code


def _reason(path: Path, error: sqlite3.Error) -> str:
    """Return why the system refused to write; SQLite does not report it, so a plain file of that size is tried."""
    if _is(error, sqlite3.SQLITE_FULL):
        return refusal(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))) or ""
    try:
        with replacing(path.with_suffix(".probe")) as new:
            new.write_bytes(bytes((path.stat().st_size if path.exists() else 0) + PROBE))
        path.with_suffix(".probe").unlink()
    except SystemRefusedError as refused:
        return str(refused).partition(" cannot be written: ")[2]
    return str(error)


def _cells_in(stored: bytes) -> dict[str, Any] | None:
    """Return the cells of a rig; None if they are damaged, which their checksum shows."""
    try:
        found: dict[str, Any] = json.loads(zlib.decompress(stored))
    except (zlib.error, ValueError, TypeError):
        return None
    return found


def read_table(folder: Path) -> Any:
    """Return the table of a fleet's results as a `pyarrow.Table`."""
    from pyarrow import ArrowInvalid, parquet

    try:
        return parquet.read_table(folder / TABLE, partitioning=None)
    except (OSError, ArrowInvalid) as error:
        raise LogError(f"{folder}: no results of `replant fleet` there ({TABLE} cannot be read)") from error


def column(table: Any, name: str) -> Any:
    """Return a column of numbers as float64; NaN if unknown."""
    return np.asarray(table.column(name).to_numpy(zero_copy_only=False), np.float64)


def verdicts_of(table: Any) -> np.ndarray[tuple[int], np.dtype[np.object_]]:
    """Return the verdict of each rig of a table (N,), or `FAILED`."""
    return np.asarray(table.column("verdict").to_pylist(), object)


FAILED = "failed"  # in place of the verdict of a rig that could not be identified


def schema(shape: Shape) -> Any:
    """Return the columns of the table of results as a `pyarrow.Schema`."""
    import pyarrow

    text, number, count = pyarrow.string(), pyarrow.float64(), pyarrow.int64()
    fields = [("rig", text), ("verdict", text), ("reasons", text)]
    fields += [(each, number) for name in shape.names for each in (name, f"{name}_std")]
    for _, end, structure in shape.branches:
        poles = [f"pole{k}_{part}" for k in range(1, structure.poles + 1) for part in ("real", "imag")]
        fields += [(f"{name}{end}", number) for name in (*poles, "damping", "dc_gain", "dc_gain_std")]
    fields += [(name, number) for name in ("fit", "fit_one_step", "dt")]
    fields += [("samples", count), ("recorded", count), ("rejected", count), ("rejected_why", text)]
    moved = [f"input_std{end}" for _, end, _ in shape.branches]
    fields += [(name, number) for name in ("begin", "end", *moved, "output_std", "output_held")]
    fields += [("source", text), ("files", count), ("notes", text), ("covariance", pyarrow.list_(number))]
    return pyarrow.schema(fields)


def cells_of(shape: Shape, model: Model | RowModel | None, **known: Any) -> dict[str, Any]:
    """Return the cells of a rig by column as a JSON object, without unknown numbers, and the JSON of its model."""
    cells: dict[str, Any] = {"samples": 0, "rejected": 0, "rejected_why": "", "notes": "", **known}
    if model is not None:
        text = json.dumps(json.loads(model.to_json()), ensure_ascii=False)  # in one line
        covariance = None if model.covariance is None else model.covariance.ravel().tolist()
        cells |= {"model": text, "covariance": covariance, **_figures(model, shape)}
    cells = {name: printable(value) if isinstance(value, str) else value for name, value in cells.items()}
    return {name: value for name, value in cells.items() if not isinstance(value, float) or math.isfinite(value)}


def _figures(model: Model | RowModel, shape: Shape) -> dict[str, float]:
    """Return the numbers of a model by column; of one without an estimate, all of whose parameters are 0, only dt."""
    if not model.parameters.any():
        return {"dt": model.dt}
    found = dict(zip(shape.names, model.parameters.tolist(), strict=True))
    if isinstance(model, RowModel):
        plants, known = model.transfer_functions, model.uncertainty
    else:
        plants, known = (model.transfer_function,), None if model.uncertainty is None else (model.uncertainty,)
    if known is not None:
        stds = np.concatenate([each.std for each in known]).tolist()
        found |= {f"{name}_std": std for name, std in zip(shape.names, stds, strict=True)}
        gain_stds = zip(shape.branches, known, strict=True)
        found |= {f"dc_gain_std{end}": each.dc_gain_std for (_, end, _), each in gain_stds}
    for plant, (_, end, _) in zip(plants, shape.branches, strict=True):
        poles = sorted(plant.poles.tolist(), key=lambda pole: (abs(pole), pole.real, pole.imag))
        for k, pole in enumerate(map(complex, poles), 1):
            found |= {f"pole{k}_real{end}": pole.real, f"pole{k}_imag{end}": pole.imag}
        with np.errstate(all="ignore"):
            found[f"dc_gain{end}"] = float(plant.dc_gain)
        found[f"damping{end}"] = min(mode.damping for mode in plant.modes)
    return found | {"fit": model.simulated_fit, "fit_one_step": model.one_step_fit, "dt": model.dt}
