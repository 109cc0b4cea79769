"""Sixty odd files: one record of a plant as many programs would write it, and files that are no record."""

from __future__ import annotations

import bz2
import gzip
import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

import replant as rp
from replant.signals import prbs

PLANT = rp.TransferFunction([4.0], [1.0, 2.0])
DT = 0.02
K = 500
T = np.arange(K) * DT
U = prbs(K, hold=10, bits=7)
Y = PLANT.simulate(U, DT)
START = datetime(2024, 5, 13, 10, 0, 0)
UNEVEN = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, K)) * DT
"""Stamps of a clock that jitters by half an interval, from well above 0."""


@dataclass(frozen=True)
class OddFile:
    """A file, how it is asked for, and what has to come of it.

    Attributes
    ----------
    name : str
        What is odd about it.
    write : callable
        From a folder that exists to the path written there.
    options : tuple of str
        In addition to those that name the columns.
    columns : tuple of str
        Input and output.
    refused : str
        What the one line on standard error has to say; empty if the plant has to come out.
    packages : tuple of str
        Those that it needs.
    """

    name: str
    write: Callable[[Path], Path]
    options: tuple[str, ...] = ()
    columns: tuple[str, str] = ("u", "y")
    refused: str = ""
    packages: tuple[str, ...] = ()


def answer(stamps: np.ndarray, u: np.ndarray = U) -> np.ndarray:
    """Return the plant's output at stamps, its input held between them: its one state, solved exactly."""
    y, fall = np.zeros(stamps.size), np.exp(-2.0 * np.diff(stamps))
    for k, kept in enumerate(fall):
        y[k + 1] = kept * y[k] + 2.0 * (1.0 - kept) * u[k]
    return y


def text(name: str, rows: list[str], end: str = "\n", encoding: str = "utf-8") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / name
        path.write_bytes((end.join(rows) + end).encode(encoding))
        return path

    return write


def rows(*columns: Any, header: str = "t,u,y", mark: str = ",", form: str = "{:.10g}") -> list[str]:
    cells = zip(
        *[[each if isinstance(each, str) else form.format(each) for each in column] for column in columns], strict=True
    )
    return ([header] if header else []) + [mark.join(row) for row in cells]


def comma(*columns: Any, header: str, **more: Any) -> list[str]:
    plain = rows(*columns, header="", mark=";", **more)
    return [header] + [row.replace(".", ",") for row in plain]


def dates(form: str, step: float = DT, digits: int = 6) -> list[str]:
    stamps = [START + timedelta(seconds=step * k) for k in range(K)]
    return [stamp.strftime(form).replace("FRACTION", f"{stamp.microsecond:06d}"[:digits]) for stamp in stamps]


def thousands(values: np.ndarray) -> list[str]:
    return [f"{value:,.4f}".replace(",", " ").replace(".", ",").replace(" ", ".") for value in values]


def packed(suffix: str, pack: Callable[[bytes], bytes]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / f"log.csv{suffix}"
        path.write_bytes(pack("\n".join(rows(T, U, Y)).encode() + b"\n"))
        return path

    return write


def zipped(*names: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / "log.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for name in names:
                archive.writestr(name, "\n".join(rows(T, U, Y)))
        return path

    return write


def zstd(folder: Path) -> Path:
    import zstandard

    return packed(".zst", zstandard.ZstdCompressor().compress)(folder)


def lines_of_json(folder: Path) -> Path:
    path = folder / "log.jsonl"
    entries = ({"t": t, "rig": {"u": u, "y": y}} for t, u, y in zip(T.tolist(), U.tolist(), Y.tolist(), strict=True))
    path.write_text("\n".join(map(json.dumps, entries)))
    return path


def npz(folder: Path, **arrays: Any) -> Path:
    np.savez(folder / "log.npz", **arrays)
    return folder / "log.npz"


def mat(folder: Path, **variables: Any) -> Path:
    from scipy import io

    io.savemat(folder / "log.mat", variables)
    return folder / "log.mat"


def simulink(folder: Path) -> Path:
    signals = np.empty((1, 2), dtype=[("values", "O"), ("label", "O")])
    signals[0, 0] = (U.reshape(-1, 1), "u")
    signals[0, 1] = (Y.reshape(-1, 1), "y")
    return mat(folder, scope={"time": T.reshape(-1, 1), "signals": signals})


def table(columns: dict[str, Any]) -> Any:
    import pyarrow as pa

    return pa.table(columns)


def parquet(folder: Path, columns: dict[str, Any], **options: Any) -> Path:
    import pyarrow.parquet as pq

    pq.write_table(table(columns), folder / "log.parquet", **options)
    return folder / "log.parquet"


def parts(folder: Path) -> Path:
    import pyarrow.parquet as pq

    path = folder / "log.parquet"
    path.mkdir()
    for k, part in enumerate((slice(0, 200), slice(200, K))):
        pq.write_table(table({"t": T[part], "u": U[part], "y": Y[part]}), path / f"part-{k}.parquet")
    return path


def feather(folder: Path) -> Path:
    from pyarrow import feather as writer

    writer.write_feather(table({"t": T, "u": U, "y": Y}), folder / "log.feather")
    return folder / "log.feather"


def arrow_stream(folder: Path) -> Path:
    import pyarrow as pa

    whole = table({"t": T, "u": U, "y": Y})
    with pa.OSFile(str(folder / "log.arrow"), "wb") as file, pa.ipc.new_stream(file, whole.schema) as writer:
        writer.write_table(whole)
    return folder / "log.arrow"


def xlsx(folder: Path, *above: list[Any], header: tuple[str, ...] = ("t", "u", "y"), when: Any = None) -> Path:
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    for row in [*above, list(header), *zip(when or T.tolist(), U.tolist(), Y.tolist(), strict=True)]:
        sheet.append(row)
    book.save(folder / "log.xlsx")
    return folder / "log.xlsx"


def hdf5(folder: Path, **datasets: Any) -> Path:
    import h5py

    with h5py.File(folder / "log.h5", "w") as file:
        for name, value in datasets.items():
            file["rig/" + name] = value
    return folder / "log.h5"


def pandas_hdf5_like(folder: Path) -> Path:
    """A compound data set, as PyTables and LabVIEW write it."""
    import h5py

    record = np.rec.fromarrays([T, U, Y], names="t,u,y")
    with h5py.File(folder / "log.h5", "w") as file:
        file["table"] = record
    return folder / "log.h5"


def tdms(folder: Path) -> Path:
    import nptdms

    start = np.datetime64("2024-05-13T10:00:00.000000")
    with nptdms.TdmsWriter(str(folder / "log.tdms")) as writer:
        wave = {"wf_start_time": start, "wf_start_offset": 0.0, "wf_increment": DT}
        writer.write_segment([nptdms.ChannelObject("rig", n, v, properties=wave) for n, v in (("u", U), ("y", Y))])
    return folder / "log.tdms"


def mf4(folder: Path) -> Path:
    import asammdf

    with asammdf.MDF(version="4.10") as file:
        coarse = slice(None, None, 10)  # the input changes every ten samples: a raster of its own
        file.append([asammdf.Signal(U[coarse], T[coarse], name="u")], common_timebase=True)
        file.append([asammdf.Signal(Y, T, name="y")], common_timebase=True)
        file.save(folder / "log.mf4")
    return folder / "log.mf4"


def mcap(folder: Path) -> Path:
    from mcap_ros2.writer import Writer

    start = 1_715_594_400_000_000_000
    with (folder / "log.mcap").open("wb") as file:
        writer = Writer(file)
        number = writer.register_msgdef("std_msgs/msg/Float64", "float64 data")
        for k in range(K):
            at = start + 20_000_000 * k
            if k % 10 == 0:
                writer.write_message("/drive", number, {"data": float(U[k])}, at, at)
            writer.write_message("/speed", number, {"data": float(Y[k])}, at, at)
        writer.finish()
    return folder / "log.mcap"


def ulog(folder: Path) -> Path:
    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<H", len(content)) + kind + content

    first = 10**12
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", first) + message(b"B", bytes(40))
    body = message(b"F", b"rig:uint64_t timestamp;float[2] control;") + message(b"A", struct.pack("<BH", 0, 0) + b"rig")
    stamps = zip(range(K), U, Y, strict=True)
    body += b"".join(message(b"D", struct.pack("<HQ2f", 0, first + 20_000 * k, u, y)) for k, u, y in stamps)
    (folder / "log.ulg").write_bytes(head + body)
    return folder / "log.ulg"


def raw(name: str, content: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return write


GAPPED = np.r_[0:200, 230:K]
PIECES = rows(T, U, Y)
ISO = dates("%Y-%m-%dT%H:%M:%S.FRACTIONZ")
LOCAL = dates("%d.%m.%Y %H:%M:%S,FRACTION")
BIG = 1000.0 * Y + 3000.0

ODD_FILES = [
    # text, by its form
    OddFile("tabs", text("log.tsv", rows(T, U, Y, header="t\tu\ty", mark="\t"))),
    OddFile("blanks in columns", text("log.txt", rows(T, U, Y, header="t   u   y", mark="   "))),
    OddFile("bars", text("log.txt", rows(T, U, Y, header="t|u|y", mark="|"))),
    OddFile("semicolons and decimal commas", text("log.csv", comma(T, U, Y, header="t;u;y"))),
    OddFile(
        "thousands with points",
        text("log.csv", rows(thousands(T), thousands(U), thousands(BIG), header="t;u;y", mark=";")),
    ),
    OddFile("carriage returns", text("log.csv", PIECES, "\r\n")),
    OddFile("byte order mark", text("log.csv", PIECES, encoding="utf-8-sig")),
    OddFile("UTF-16", text("log.csv", PIECES, encoding="utf-16")),
    OddFile(
        "Latin-1 in the header",
        text("log.csv", rows(T, U, Y, header="t,u,y °C"), encoding="latin-1"),
        columns=("u", "2"),
    ),
    OddFile("no header", text("log.csv", rows(T, U, Y, header="")), ("--time", "0"), ("1", "2")),
    OddFile("comments above", text("log.csv", ["# motor test", "# operator: Smith", *PIECES])),
    OddFile("lines of text above", text("log.csv", ["Motor test", "", *PIECES])),
    OddFile("units below the names", text("log.csv", ["t,u,y", "s,V,mm", *PIECES[1:]])),
    OddFile("units in brackets", text("log.csv", rows(1000 * T, U, Y, header="t [ms],u [V],y [mm]"))),
    OddFile(
        "quoted names and numbers",
        text("log.csv", ['"t","u","y"', *(",".join(f'"{c}"' for c in r.split(",")) for r in PIECES[1:])]),
    ),
    OddFile("exponents", text("log.csv", rows(T, U, Y, form="{:.9e}"))),
    OddFile("a comma behind each row", text("log.csv", [row + "," for row in PIECES])),
    OddFile("blank lines between", text("log.csv", [line for row in PIECES for line in (row, "")])),
    OddFile("a last line that was cut off", raw("log.csv", "\n".join([*PIECES, "10.0,1"]).encode())),
    OddFile("columns of text beside", text("log.csv", rows(T, ["on"] * K, U, Y, header="t,state,u,y"))),
    OddFile(
        "missing outputs as NaN",
        text("log.csv", rows(T, U, ["NaN" if k % 50 == 7 else f"{y:.10g}" for k, y in enumerate(Y)])),
    ),
    OddFile(
        "missing outputs as empty cells",
        text("log.csv", rows(T, U, ["" if k % 50 == 7 else f"{y:.10g}" for k, y in enumerate(Y)])),
    ),
    OddFile("an outlier", text("log.csv", rows(T, U, np.where(np.arange(K) == 250, 1e6, Y)))),
    # text, by its clock
    OddFile("ISO dates in UTC", text("log.csv", rows(ISO, U, Y))),
    OddFile("ISO dates with an offset", text("log.csv", rows([d.replace("Z", "+02:00") for d in ISO], U, Y))),
    OddFile(
        "local dates with decimal commas",
        text("log.csv", ["t;u;y", *(f"{d};{r}" for d, r in zip(LOCAL, comma(U, Y, header="")[1:], strict=True))]),
    ),
    OddFile(
        "date and clock in two columns",
        text("log.csv", rows(dates("%Y-%m-%d"), dates("%H:%M:%S.FRACTION"), U, Y, header="date,clock,u,y")),
    ),
    OddFile("clock time alone", text("log.csv", rows(dates("%H:%M:%S.FRACTION"), U, Y))),
    OddFile("milliseconds by name", text("log.csv", rows(1000 * T, U, Y, header="time_ms,u,y")), ("--time", "time_ms")),
    OddFile("microseconds by name", text("log.csv", rows(1e6 * T, U, Y, header="t_us,u,y")), ("--time", "t_us")),
    OddFile(
        "nanoseconds since 1970",
        text(
            "log.csv",
            rows([str(1_715_594_400_000_000_000 + 20_000_000 * k) for k in range(K)], U, Y, header="timestamp_ns,u,y"),
        ),
        ("--time", "timestamp_ns"),
    ),
    OddFile("seconds since 1970", text("log.csv", rows([f"{1_715_594_400 + t:.6f}" for t in T], U, Y))),
    OddFile("a sample number and --dt", text("log.csv", rows(U, Y, header="u,y")), ("--dt", str(DT))),
    OddFile("a clock that jitters", text("log.csv", rows(UNEVEN, U, answer(UNEVEN)))),
    OddFile("a gap of 30 samples", text("log.csv", rows(T[GAPPED], U[GAPPED], Y[GAPPED]))),
    OddFile(
        "stamps rounded to milliseconds", text("log.csv", rows(np.round(UNEVEN, 3), U, answer(np.round(UNEVEN, 3))))
    ),
    # packed
    OddFile("gzip", packed(".gz", gzip.compress)),
    OddFile("zip", zipped("log.csv")),
    OddFile("zstd", zstd, packages=("zstandard",)),
    # other programs
    OddFile("JSON lines of nested objects", lines_of_json, columns=("rig.u", "rig.y")),
    OddFile("NumPy, Ts beside", lambda folder: npz(folder, u=U, y=Y, Ts=DT)),
    OddFile(
        "NumPy, a matrix",
        lambda folder: npz(folder, t=T, log=np.column_stack([U, Y])),
        columns=("log[:,0]", "log[:,1]"),
    ),
    OddFile("MATLAB, row vectors", lambda folder: mat(folder, t=T, u=U, y=Y)),
    OddFile(
        "MATLAB, Ts in a struct",
        lambda folder: mat(folder, data={"u": U, "y": Y, "Ts": DT}),
        columns=("data.u", "data.y"),
    ),
    OddFile("Simulink, structure with time", simulink, columns=("scope.signals(1).values", "scope.signals(2).values")),
    OddFile("Parquet", lambda folder: parquet(folder, {"t": T, "u": U, "y": Y}), packages=("pyarrow",)),
    OddFile(
        "Parquet of float32 and integers",
        lambda folder: parquet(folder, {"t": T, "u": U.astype(np.int8), "y": Y.astype(np.float32)}),
        packages=("pyarrow",),
    ),
    OddFile("Parquet, a folder of parts", parts, packages=("pyarrow",)),
    OddFile("Feather", feather, packages=("pyarrow",)),
    OddFile("an Arrow stream", arrow_stream, packages=("pyarrow",)),
    OddFile("Excel, a title above", lambda folder: xlsx(folder, ["Motor test"], []), packages=("openpyxl",)),
    OddFile(
        "Excel, dates",
        lambda folder: xlsx(folder, when=[START + timedelta(seconds=DT * k) for k in range(K)]),
        packages=("openpyxl",),
    ),
    OddFile("HDF5 groups", lambda folder: hdf5(folder, t=T, u=U, y=Y), columns=("rig/u", "rig/y"), packages=("h5py",)),
    OddFile("HDF5, a table of records", pandas_hdf5_like, columns=("table.u", "table.y"), packages=("h5py",)),
    OddFile("TDMS waveforms", tdms, columns=("rig/u", "rig/y"), packages=("nptdms",)),
    OddFile("MDF 4, two rasters", mf4, packages=("asammdf",)),
    OddFile("MCAP of ROS 2, two rates", mcap, columns=("/drive.data", "/speed.data"), packages=("mcap_ros2",)),
    OddFile("ULog", ulog, columns=("rig.control[0]", "rig.control[1]"), packages=("pyulog",)),
    # no record, or one that nobody could read rightly: one line that helps
    OddFile("an empty file", raw("log.csv", b""), refused="empty"),
    OddFile("a header alone", raw("log.csv", b"t,u,y\n"), refused="no rows|no samples|no numbers|only a header"),
    OddFile(
        "a picture",
        raw("log.csv", b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 8),
        refused="binary|not text|not a text|no numbers|cannot be read|column",
    ),
    OddFile("a picture by its name", raw("log.png", b"\x89PNG\r\n\x1a\n" + bytes(300)), refused="png"),
    OddFile("an archive of two files", zipped("a.csv", "b.csv"), refused="a.csv, b.csv|2 files|two files"),
    OddFile("an unknown compression", packed(".bz2", bz2.compress), refused="bz2"),
    OddFile(
        "a gzip file that was cut off",
        packed(".gz", lambda content: gzip.compress(content)[:-60]),
        refused="cut off|damaged|truncated|ended|end",
    ),
    OddFile(
        "time that goes back",
        text("log.csv", rows(np.where(np.arange(K) == 300, 0.0, T), U, Y)),
        refused="increase|goes back|back",
    ),
    OddFile(
        "time that stands still",
        text("log.csv", rows(np.where(np.arange(K) == 300, T[299], T), U, Y)),
        refused="repeats the one before",
    ),
    OddFile("no time and no --dt", text("log.csv", rows(U, Y, header="u,y")), refused="--dt"),
    OddFile(
        "a word among the numbers",
        text("log.csv", [*PIECES[:200], "3.98,offline,0.1", *PIECES[200:]]),
        refused="offline",
    ),
    OddFile("a row that is too short", text("log.csv", [*PIECES[:200], "3.98,1", *PIECES[200:]]), refused="row|line"),
    OddFile(
        "a number that may be two",
        text("log.csv", rows(thousands(T), ["1.234"] * K, ["0,5"] * K, header="t;u;y", mark=";")),
        refused="1.234|decimal|thousand",
    ),
    OddFile(
        "two columns of one name", text("log.csv", rows(T, U, Y, Y, header="t,u,y,y")), refused="could be any of 2"
    ),
    OddFile(
        "an output that is missing throughout",
        text("log.csv", rows(T, U, ["NaN"] * K)),
        refused="no |none|missing|finite|usable",
    ),
    OddFile(
        "daylight saving time",
        text(
            "log.csv",
            rows(dates("2024-10-27 02:%M:%S.FRACTION")[:250] + dates("2024-10-27 01:%M:%S.FRACTION")[250:], U, Y),
        ),
        refused="back|daylight|offset",
    ),
]
