"""Store: the folder of a fleet's results, and the row that is kept of a rig."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs.arrow import CHECKED
from replant.errors import InvalidArgumentError, LogError, MissingDependencyError, SystemRefusedError
from replant.fleet.job import (
    ABOUT,
    MANIFEST,
    MARK,
    MODELS,
    PARTS,
    TABLE,
    TIMING,
    Job,
    Rig,
    clear,
    foreign,
    printable,
    replacing,
    report_path,
)
from replant.fleet.records import UNKNOWN, Movement
from replant.identified.model import Model
from replant.model.structure import Structure
from replant.operating_system import refusal

CHUNK_ROWS = 1 << 14  # rows that are merged at a time [rows]
PARTS_HELD = 64  # parts that are held in memory while they are merged [count]


class Store:
    """The folder of a fleet's results."""

    def __init__(self, folder: Path, job: Job) -> None:
        if importlib.util.find_spec("pyarrow") is None:
            raise MissingDependencyError("the results of a fleet are Parquet files: pip install 'replant[parquet]'")
        self.folder, self.job = folder.absolute(), job
        try:
            others = foreign(self.folder)
            if others:
                raise InvalidArgumentError(
                    f"{folder}: {', '.join(others)} there are not of a fleet, and would be overwritten; name another "
                    "folder (out, --out)"
                )
            for each in (PARTS, MANIFEST):
                (self.folder / each).mkdir(parents=True, exist_ok=True)
            (self.folder / MANIFEST / MARK).touch()
        except OSError as error:
            raise SystemRefusedError(f"{folder} cannot be written: {refusal(error)}") from error

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Hold the folder: two runs that write into the same one would do the work twice."""
        try:
            import fcntl
        except ImportError:  # Windows
            self._clear()
            yield
            return
        with (self.folder / MANIFEST / MARK).open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise SystemRefusedError(
                    f"{self.folder}: another run writes there; wait for its end, or give another folder"
                ) from error
            self._clear()
            yield

    def _clear(self) -> None:
        """Remove what killed writers have left; only while the folder is held, as others may be writing."""
        for each in (self.folder / PARTS, self.folder / MANIFEST, self.folder):
            clear(each)

    def forget_reports(self, rigs: Sequence[Rig]) -> None:
        """Remove the reports of rigs that are identified anew: the page would lead to those of the models before."""
        for rig in rigs:
            with contextlib.suppress(OSError):
                (self.folder / report_path(rig.name)).unlink(missing_ok=True)

    def done(self, rigs: Sequence[Rig]) -> dict[str, str]:
        """Return the rigs whose results are there, made from the same files by the same job, and the part of each."""
        wanted = {rig.name: rig.fingerprint for rig in rigs}
        found: dict[str, str] = {}
        for entry in sorted((self.folder / MANIFEST).glob("*.json")):
            written = _entry(entry)
            if written.get("job") != self.job.key or not self._part(entry.stem).exists():
                continue
            for name, fingerprint in written["rigs"].items():
                if wanted.get(name) == fingerprint:
                    found.setdefault(name, entry.stem)
        return found

    def merge(self, rigs: Sequence[Rig], about: dict[str, Any]) -> None:
        """Write the table of all rigs, sorted by their names, the seconds of each, and the models."""
        import pyarrow
        from pyarrow import parquet

        done, held, models_written = self.done(rigs), _Parts(self.folder / PARTS), 0
        columns = schema(self.job.structure)
        seconds = pyarrow.schema([("rig", pyarrow.string()), ("seconds", pyarrow.float64())])
        with ExitStack() as files:
            table, timing, models = (
                files.enter_context(replacing(self.folder / name)) for name in (TABLE, TIMING, MODELS)
            )
            rows = files.enter_context(parquet.ParquetWriter(table, columns, **CHECKED))
            times = files.enter_context(parquet.ParquetWriter(timing, seconds, **CHECKED))
            lines = files.enter_context(models.open("w", encoding="utf-8"))
            for start in range(0, len(rigs), CHUNK_ROWS):
                names = [rig.name for rig in rigs[start : start + CHUNK_ROWS]]
                chunk = held.rows(names, [done[name] for name in names])
                rows.write_table(chunk.select(columns.names))
                times.write_table(chunk.select(seconds.names))
                for name, model in zip(names, chunk.column("model").to_pylist(), strict=True):
                    if model is not None:
                        lines.write(f'{{"rig": {json.dumps(name)}, "model": {model}}}\n')
                        models_written += 1
        with replacing(self.folder / ABOUT) as new:
            new.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        if models_written:  # else an option is wrong, and what was done before is wanted again
            self._forget_all_but(set(done.values()))

    def _part(self, key: str) -> Path:
        return self.folder / PARTS / f"{key}.parquet"

    def _forget_all_but(self, used: set[str]) -> None:
        """Remove parts of which nothing is used any more: of other options, or of files that have changed."""
        for folder in (MANIFEST, PARTS):
            for path in (self.folder / folder).iterdir():
                if path.suffix in (".json", ".parquet") and path.stem not in used:
                    with contextlib.suppress(OSError):
                        path.unlink()


class _Parts:
    """The parts of the results, of which the latest used ones are held: neighbours by name mostly share one."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._held: OrderedDict[str, tuple[Any, dict[str, int]]] = OrderedDict()

    def rows(self, names: Sequence[str], parts: Sequence[str]) -> Any:
        """Return the rows of rigs as a `pyarrow.Table`, in their order."""
        import pyarrow

        pieces, begin = [], 0
        for end in range(1, len(names) + 1):
            if end == len(names) or parts[end] != parts[begin]:
                table, places = self._open(parts[begin])
                pieces.append(table.take([places[name] for name in names[begin:end]]))
                begin = end
        return pyarrow.concat_tables(pieces).combine_chunks()

    def _open(self, key: str) -> tuple[Any, dict[str, int]]:
        from pyarrow import parquet

        if key not in self._held:
            table = parquet.read_table(self._folder / f"{key}.parquet", partitioning=None)
            self._held[key] = table, {name: row for row, name in enumerate(table.column("rig").to_pylist())}
        self._held.move_to_end(key)
        while len(self._held) > PARTS_HELD:
            self._held.popitem(last=False)
        return self._held[key]


def read_table(folder: Path, name: str = TABLE) -> Any:
    """Return a table of a fleet's results as a `pyarrow.Table`."""
    from pyarrow import ArrowInvalid, parquet

    try:
        return parquet.read_table(folder / name, partitioning=None)
    except (OSError, ArrowInvalid) as error:
        raise LogError(f"{folder}: no results of `replant fleet` there ({name} cannot be read)") from error


def column(table: Any, name: str) -> Any:
    """Return a column of numbers as float64; NaN where it is not known."""
    return np.asarray(table.column(name).to_numpy(zero_copy_only=False), np.float64)


def _entry(path: Path) -> dict[str, Any]:
    """Return an entry of the manifest; an empty one where it cannot be read, so that its rigs are done again."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) and isinstance(found.get("rigs"), dict) else {}


FAILED = "failed"  # what stands in place of the verdict where a rig could not be identified


@dataclass(frozen=True, eq=False)
class Row:
    """What is kept of a rig."""

    rig: str
    verdict: str  # the status, or `FAILED`
    reasons: tuple[str, ...]
    source: str  # its first file, from the folder of all logs on
    files: int
    model: Model | None = None
    samples: int = 0
    rejected: tuple[tuple[str, int], ...] = ()  # samples left out, by reason
    # begin, end: time of the first and of the last sample in s; dates of Parquet files since 1970
    begin: float = math.nan
    end: float = math.nan
    movement: Movement = UNKNOWN
    notes: tuple[str, ...] = ()  # what is to be known of the files, such as a line that was left out
    seconds: float = 0.0  # how long it took


def table_of(rows: Sequence[Row], structure: Structure) -> Any:
    """Return rows as a `pyarrow.Table`: the columns of `schema`, the model's JSON, and the seconds that each took."""
    import pyarrow

    columns: dict[str, list[Any]] = {field.name: [] for field in schema(structure)} | {"model": [], "seconds": []}
    for row in rows:
        cells = _cells(row, structure)
        for name, values in columns.items():
            values.append(cells.get(name))
    return pyarrow.table(columns, schema=part_schema(structure))


def schema(structure: Structure) -> Any:
    """Return the columns of the table of results as a `pyarrow.Schema`."""
    import pyarrow

    text, number, count = pyarrow.string(), pyarrow.float64(), pyarrow.int64()
    fields = [("rig", text), ("verdict", text), ("reasons", text)]
    fields += [(each, number) for name in structure.names for each in (name, f"{name}_std")]
    fields += [(f"pole{k}_{part}", number) for k in range(1, structure.poles + 1) for part in ("real", "imag")]
    fields += [(name, number) for name in ("damping", "dc_gain", "dc_gain_std", "fit", "fit_one_step", "dt")]
    fields += [("samples", count), ("rejected", count), ("rejected_why", text)]
    fields += [(name, number) for name in ("begin", "end", "input_std", "output_std", "output_held")]
    fields += [("source", text), ("files", count), ("notes", text), ("covariance", pyarrow.list_(number))]
    return pyarrow.schema(fields)


def part_schema(structure: Structure) -> Any:
    """Return the columns of a task's part of the results."""
    import pyarrow

    return schema(structure).append(pyarrow.field("model", pyarrow.string())).append(
        pyarrow.field("seconds", pyarrow.float64())
    )  # fmt: skip


def _cells(row: Row, structure: Structure) -> dict[str, Any]:
    """Return the cells of a row by column; a figure that is not known is left out."""
    numbers: dict[str, float] = {"begin": row.begin, "end": row.end, **vars(row.movement)}
    cells: dict[str, Any] = {
        "rig": row.rig, "verdict": row.verdict, "reasons": printable("; ".join(row.reasons)), "source": row.source,
        "files": row.files, "notes": printable("; ".join(row.notes)), "samples": row.samples,
        "rejected": sum(count for _, count in row.rejected),
        "rejected_why": ", ".join(f"{count} {why}" for why, count in row.rejected if count), "seconds": row.seconds,
    }  # fmt: skip
    if row.model is not None:
        cells |= {"model": _one_line(row.model), "covariance": _flat(row.model.covariance)}
        numbers |= _figures(row.model, structure)
    return cells | {name: value for name, value in numbers.items() if math.isfinite(value)}


def _one_line(model: Model) -> str:
    return json.dumps(json.loads(model.to_json()), ensure_ascii=False)


def _flat(covariance: FloatArray | None) -> list[float] | None:
    return None if covariance is None else covariance.ravel().tolist()


def _figures(model: Model, structure: Structure) -> dict[str, float]:
    known, transfer = model.uncertainty, model.transfer_function
    found = dict(zip(structure.names, model.parameters.tolist(), strict=True))
    if known is not None:
        found |= {f"{name}_std": std for name, std in zip(structure.names, known.std.tolist(), strict=True)}
        found["dc_gain_std"] = known.dc_gain_std
    poles = sorted(transfer.poles.tolist(), key=lambda pole: (abs(pole), pole.real, pole.imag))
    for k, pole in enumerate(poles, 1):
        found |= {f"pole{k}_real": complex(pole).real, f"pole{k}_imag": complex(pole).imag}
    with np.errstate(all="ignore"):
        found["dc_gain"] = float(transfer.dc_gain)
    found["damping"] = min(mode.damping for mode in transfer.modes)
    return found | {"fit": model.simulated_fit, "fit_one_step": model.one_step_fit, "dt": model.dt}
