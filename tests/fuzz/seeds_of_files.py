"""The small valid files that mutants are made of, of every format that is read."""

from __future__ import annotations

import gzip
import io
import json
import struct
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROWS = 8
T = np.arange(ROWS) * 0.1
U = np.arange(ROWS) % 3.0
Y = np.round(np.sin(T), 4)


def text() -> bytes:
    return b"t [s],u,y\n" + "".join(f"{t:.1f},{u},{y}\n" for t, u, y in zip(T, U, Y, strict=True)).encode()


def other_text() -> bytes:
    head = '# rig 7\nMotor test\n"t";"u, [V]";y;when\n'
    rows = zip(T, U, Y, strict=True)
    return (head + "".join(f"{t:.1f};{u};1.000,5;2024-05-01 10:00:0{int(10 * t)}\n" for t, u, _ in rows)).encode()


def jsonl() -> bytes:
    rows = zip(T.tolist(), U.tolist(), Y.tolist(), strict=True)
    return "".join(json.dumps({"t": t, "rig": {"u": u, "y": y, "at": "10:00:01"}}) + "\n" for t, u, y in rows).encode()


def npz(**more: Any) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, t=T, u=U, y=Y, m=np.asfortranarray(np.ones((ROWS, 2))), Ts=np.array(0.1), **more)
    return file.getvalue()


def npz_of_text() -> bytes:
    return npz(s=np.array(["a", "b"]), i=np.arange(ROWS, dtype=">i2"), r=np.zeros(3, [("a", "f4"), ("b", "i1")]))


def mat(*, compressed: bool = False, version: str = "5") -> bytes:
    import scipy.io

    file = io.BytesIO()
    variables: dict[str, Any] = {"t": T, "u": U, "y": Y, "m": np.ones((ROWS, 2), np.int8)}
    if version == "5":
        variables |= {"data": {"t": T, "udat": np.ones((ROWS, 2)), "note": "rig 7"}, "c": np.array(["a", 1.0], object)}
    scipy.io.savemat(file, variables, format=version, do_compression=compressed)
    return file.getvalue()


def hdf5(**options: Any) -> bytes:
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w", **options) as opened:
        opened["t"], opened["rig/u"] = T, U
        opened.create_dataset("rig/y", data=Y, chunks=(4,), compression="gzip")
        opened["table"] = np.rec.fromarrays([T, U.astype("i2")], names="t,u")
        opened["Ts"] = 0.1
    return file.getvalue()


def mat73() -> bytes:
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w", userblock_size=512) as opened:
        for name, values in (("t", T), ("u", U), ("data/y", Y)):
            opened[name] = values.reshape(1, -1)
            opened[name].attrs["MATLAB_class"] = np.bytes_("double")
    return b"MATLAB 7.3 MAT-file".ljust(512, b" ") + file.getvalue()[512:]


def table() -> Any:
    import pyarrow as pa

    stamps = pa.array([1_000_000_000 * k for k in range(ROWS)], pa.timestamp("ns"))
    missing = pa.array([None, *Y[1:].tolist()])
    return pa.table({"t": T, "u": U, "y": Y, "b": U > 1, "s": ["a"] * ROWS, "n": missing, "when": stamps})


def parquet(**options: Any) -> bytes:
    from pyarrow import parquet as pq

    file = io.BytesIO()
    pq.write_table(table(), file, **options)
    return file.getvalue()


def arrow(*, stream: bool = False, compression: str | None = None) -> bytes:
    import pyarrow as pa

    file = io.BytesIO()
    whole = table()
    options = pa.ipc.IpcWriteOptions(compression=compression)
    make = pa.ipc.new_stream if stream else pa.ipc.new_file
    with make(file, whole.schema, options=options) as writer:
        writer.write_table(whole)
    return file.getvalue()


def xlsx() -> bytes:
    import openpyxl

    file, book = io.BytesIO(), openpyxl.Workbook()
    book.active.append(["read me"])
    sheet = book.create_sheet("data")
    for row in (["t", "u", "y", "s"], ["s", "V", "mm", None], *zip(T.tolist(), U.tolist(), Y.tolist(), strict=True)):
        sheet.append(list(row))
    book.save(file)
    return file.getvalue()


def xlsx_of_dates() -> bytes:
    from datetime import datetime, timedelta

    import openpyxl

    file, book = io.BytesIO(), openpyxl.Workbook()
    book.active.append(["u", "y", "when"])
    for k in range(ROWS):
        book.active.append([k % 3, k == 2, datetime(2024, 5, 1) + timedelta(seconds=k)])
    book.save(file)
    return file.getvalue()


def ulog() -> bytes:
    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<H", len(content)) + kind + content

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 10**12) + message(b"B", bytes(40))
    data += message(b"F", b"part:float x;uint8_t[3] more;") + message(b"I", b"\x0dchar[5] sys_name12345")
    data += message(b"P", b"\x09float gain" + bytes(4))
    data += message(b"F", b"rig:uint64_t timestamp;float[2] control;part[2] parts;uint8_t[4] _padding0;")
    data += message(b"A", struct.pack("<BH", 0, 0) + b"rig")
    for k in range(ROWS):
        rest = struct.pack("<f3Bf3B", 1.0, 1, 2, 3, 2.0, 4, 5, 6)
        data += message(b"D", struct.pack("<HQ2f", 0, 10**12 + 20_000 * k, U[k], Y[k]) + rest)
    return data + message(b"L", b"6" + struct.pack("<Q", 10**12) + b"ready") + message(b"O", struct.pack("<H", 20))


def mcap(*, compressed: bool = True, as_json: bool = False) -> bytes:
    from mcap.writer import CompressionType, Writer

    file = io.BytesIO()
    kind = CompressionType.ZSTD if compressed else CompressionType.NONE
    writer = Writer(file, compression=kind, enable_crcs=False, chunk_size=300)
    writer.start()
    if as_json:
        schema = writer.register_schema("rig", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/rig", "json", schema)
    else:
        form = b"std_msgs/Header header\nfloat64 u\nfloat64[2] y\nstring s\n"
        form += b"=" * 80 + b"\nMSG: std_msgs/Header\nuint32 seq\nstring frame_id\n"
        schema = writer.register_schema("rig/msg/Rig", "ros2msg", form)
        channel = writer.register_channel("/rig", "cdr", schema)
    for k in range(ROWS):
        cdr = (
            b"\0\1\0\0"
            + struct.pack("<II", k, 2)
            + b"a\0"
            + bytes(6)
            + struct.pack("<3dI", U[k], Y[k], 1.0, 2)
            + b"b\0"
        )
        data = json.dumps({"u": U[k], "y": [Y[k], 1.0], "deep": {"s": "a"}}).encode() if as_json else cdr
        writer.add_message(channel, log_time=10**18 + 10**8 * k, data=data, publish_time=0)
    writer.finish()
    return file.getvalue()


def mdf(version: str = "4.10", compression: int = 0) -> bytes:
    import asammdf

    with tempfile.TemporaryDirectory() as folder, asammdf.MDF(version=version) as log:
        signals = [asammdf.Signal(values, T, name=name, unit="V") for name, values in (("u", U), ("y", Y))]
        linear = {"a": 0.5, "b": 3.0}
        signals.append(asammdf.Signal(np.arange(ROWS, dtype="u1"), T, name="z", conversion=linear))
        log.append(signals, acq_name="raster", common_timebase=True)
        log.append([asammdf.Signal(U[::2], T[::2], name="slow")], common_timebase=True)
        return Path(log.save(Path(folder, "log"), overwrite=True, compression=compression)).read_bytes()


def tdms(*, waves: bool = True) -> bytes:
    import nptdms

    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        for _ in range(2):
            more = {"wf_start_time": np.datetime64("2024-05-13T10:00:00"), "wf_increment": 0.1} if waves else {}
            parts = [nptdms.ChannelObject("rig", name, v, properties=more) for name, v in (("u", U), ("y", Y))]
            writer.write_segment([nptdms.RootObject({"title": "rig"}), *parts])
    return file.getvalue()


def zstd(content: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor(write_checksum=False).compress(content)


def zipped(content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("log.csv", content)
    return file.getvalue()


def model() -> bytes:
    from replant import Model, NoiseModel, Structure

    covariance = np.diag([1e-4, 4e-4, 1e-6])
    noise = NoiseModel([1.0, -0.5], 1e-3, 2e-3, 0.1)
    structure = Structure(1, bias=True)
    return Model(structure, [1.0, 2.0, 0.1], dt=0.1, covariance=covariance, noise=noise).to_json().encode()


Seeds = list[Callable[[], bytes]]
# name, suffix, seeds, the modules that the forks import first
FORMATS: dict[str, tuple[str, Seeds, tuple[str, ...]]] = {
    "model": (".json", [model], ()),
    "text": (".csv", [text, other_text], ()),
    "gz": (".csv.gz", [lambda: gzip.compress(text()), lambda: gzip.compress(other_text())], ()),
    "zip": (".zip", [lambda: zipped(text())], ()),
    "zst": (".csv.zst", [lambda: zstd(text()), lambda: zstd(text()[:50]) + zstd(text()[50:])], ("zstandard",)),
    "jsonl": (".jsonl", [jsonl], ()),
    "npz": (".npz", [npz, npz_of_text], ()),
    "mat": (".mat", [mat, lambda: mat(version="4"), lambda: mat(compressed=True)], ("scipy.io",)),
    "mat73": (".mat", [mat73], ("scipy.io", "h5py")),
    "hdf5": (".h5", [hdf5, lambda: hdf5(libver="latest")], ("h5py",)),
    "parquet": (
        ".parquet",
        [
            parquet,
            lambda: parquet(compression="none", use_dictionary=False),
            lambda: parquet(compression="zstd", data_page_version="2.0", row_group_size=3),
        ],
        ("pyarrow.parquet", "pyarrow.compute"),
    ),
    "arrow": (
        ".arrow",
        [arrow, lambda: arrow(stream=True), lambda: arrow(compression="lz4"), lambda: arrow(compression="zstd")],
        ("pyarrow.parquet", "pyarrow.compute"),
    ),
    "xlsx": (".xlsx", [xlsx, xlsx_of_dates], ("openpyxl",)),
    "ulog": (".ulg", [ulog], ("pyulog",)),
    "mcap": (
        ".mcap",
        [mcap, lambda: mcap(compressed=False), lambda: mcap(as_json=True)],
        ("mcap.reader", "mcap_ros2.decoder"),
    ),
    "tdms": (".tdms", [tdms, lambda: tdms(waves=False)], ("nptdms",)),
    "mdf": (".mf4", [mdf, lambda: mdf(compression=2), lambda: mdf("3.30")], ("asammdf",)),
}


def seeds_of(name: str) -> list[bytes]:
    """The valid files of a format."""
    return [make() for make in FORMATS[name][1]]


def path_of(folder: Path, name: str) -> Path:
    """Where a mutant of a format is written."""
    return folder / f"log{FORMATS[name][0]}"
