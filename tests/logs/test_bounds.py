"""The samples in a file bound its cost: decompression bombs of every container are read with memory measured."""

from __future__ import annotations

import gzip
import io
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log
from support.cases import every
from support.places import ROOT

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems count no peak of memory like this")

MOST = 300 << 20  # bytes beside three times the samples
READ = """
import gc, json, resource, sys
import replant as rp
from replant.errors import ReplantError
try:
    said = "" if rp.read_log(sys.argv[1], input=0, output=1, dt=1.0) else "nothing"
except ReplantError as error:
    said = str(error)
# ru_maxrss of the process itself counts what its caller had before it started this one
(own,) = (line for line in open("/proc/self/status") if line.startswith("VmHWM"))
gc.collect()
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([said, 1024 * (int(own.split()[1]) + used.ru_maxrss)]))
"""


def check(path: Path, samples: int = 0) -> str:
    """Return the message; check that it is one line, and that the reading processes keep within the memory bounds."""
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)],
        capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": str(ROOT / "src")},
    )  # fmt: skip
    said, memory = json.loads(done.stdout)
    print(f"{path.name}: {memory >> 20} MiB, {said}")
    assert memory < MOST + 3 * 8 * samples, f"{path.name}: {memory >> 20} MiB"
    assert not said or said.startswith(f"{path}: "), said
    assert len(said.splitlines()) == (1 if said else 0)
    assert len(said) <= len(str(path)) + 300
    return str(said)


def part(times: int, of: bytes = b"\n") -> Iterator[bytes]:
    for _ in range(times):
        yield of * (1 << 20)


# --- text


def gz(write: Callable[[Any], None]) -> bytes:
    file = io.BytesIO()
    with gzip.GzipFile(fileobj=file, mode="w", compresslevel=1) as packed:
        write(packed)
    return file.getvalue()


def zst(parts: Iterator[bytes], window: int = 0) -> bytes:
    zstandard = pytest.importorskip("zstandard")
    more = {"compression_params": zstandard.ZstdCompressionParameters(window_log=window)} if window else {}
    packer = zstandard.ZstdCompressor(**more).compressobj()
    return b"".join(map(packer.compress, parts)) + bytes(packer.flush())


def json_of_keys(rows: int, keys: int) -> bytes:
    return b"".join(json.dumps({f"k{row}_{key}": 1 for key in range(keys)}).encode() + b"\n" for row in range(rows))


def nested(depth: int, row: str = '{{"a":{}}}') -> bytes:
    inner = "1"
    for _ in range(depth):
        inner = row.format(inner)
    return inner.encode() + b"\n"


TEXTS: dict[str, Callable[[], bytes]] = {
    "line.csv": lambda: b"t,u\n" + b"1," * (30 << 20),
    "first line.csv": lambda: b"1" * (60 << 20),
    "newlines.csv": lambda: b"\n" * (30 << 20),
    "newlines below.csv": lambda: b"t,u\n1,2\n" + b"\n" * (30 << 20),
    "columns.csv": lambda: b"1," * (1 << 20) + b"1\n" + b"1," * (1 << 20) + b"1\n",
    "quotes.csv": lambda: b't,u\n"' + b"1,\n" * (10 << 20),
    "newlines.csv.gz": lambda: gz(lambda file: file.writelines(part(350))),
    "line.csv.gz": lambda: gz(lambda file: file.writelines(part(350, b"1"))),
    "newlines.csv.zst": lambda: zst(part(350)),
    "window.csv.zst": lambda: zst(part(10, os.urandom(64)), window=29),
    "keys.jsonl": lambda: json_of_keys(1000, 1000),
    "deep.jsonl": lambda: nested(900) * 1000,
    "deeper.jsonl": lambda: nested(100_000),
    "lists.jsonl": lambda: b'{"a":[' + b"[]," * (1 << 20) + b"1]}\n",
    "newlines.jsonl": lambda: b"\n" * (30 << 20),
    "objects.jsonl": lambda: b"{}\n" * (10 << 20),
}


@every("name", TEXTS, quick=2)
def test_a_bomb_of_text(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(TEXTS[name]())
    assert check(path)


def test_archives_in_archives_are_not_opened(tmp_path: Path) -> None:
    content = b"u,y\n1,2\n"
    for depth in range(3):
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("log.zip" if depth else "log.csv", content)
        content = file.getvalue()
    (tmp_path / "log.zip").write_bytes(content)
    assert "holds another compressed file" in check(tmp_path / "log.zip")


@pytest.mark.slow
@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_method_without_a_bound_is_not_unpacked(tmp_path: Path, method: int) -> None:
    with zipfile.ZipFile(tmp_path / "log.zip", "w", method) as archive:
        archive.writestr("log.csv", b"\n" * (16 << 20))
    assert "pack it again with zip" in check(tmp_path / "log.zip")


# --- workbooks

MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006"
SHEET = "application/vnd.openxmlformats-officedocument.spreadsheetml"


def workbook(
    path: Path, rows: Iterator[bytes] | list[bytes], *, head: str = "", sheets: int = 1, strings: Any = ()
) -> Path:
    """Write a workbook by hand; ``rows`` are the parts of the XML of each sheet."""
    numbers = range(1, sheets + 1)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        kinds = "".join(f'<Override PartName="/xl/s{k}.xml" ContentType="{SHEET}.worksheet+xml"/>' for k in numbers)
        file.writestr(
            "[Content_Types].xml",
            f'<Types xmlns="{PACKAGE}/content-types"><Default Extension="rels" ContentType='
            f'"application/vnd.openxmlformats-package.relationships+xml"/><Override PartName="/xl/b.xml" ContentType='
            f'"{SHEET}.sheet.main+xml"/><Override PartName="/xl/t.xml" ContentType="{SHEET}.sharedStrings+xml"/>'
            f"{kinds}</Types>",
        )
        link = f'<Relationship Id="r{{0}}" Type="{OFFICE}/{{1}}" Target="{{2}}"/>'
        top = f'<Relationships xmlns="{PACKAGE}/relationships">'
        file.writestr("_rels/.rels", top + link.format(1, "officeDocument", "xl/b.xml") + "</Relationships>")
        links = "".join(link.format(k, "worksheet", f"s{k}.xml") for k in numbers)
        links += link.format(0, "sharedStrings", "t.xml")
        file.writestr("xl/_rels/b.xml.rels", top + links + "</Relationships>")
        named = "".join(f'<sheet name="s{k}" sheetId="{k}" r:id="r{k}"/>' for k in numbers)
        file.writestr("xl/b.xml", f'<workbook xmlns="{MAIN}" xmlns:r="{OFFICE}"><sheets>{named}</sheets></workbook>')
        with file.open("xl/t.xml", "w") as part_of:
            part_of.write(f'<sst xmlns="{MAIN}">'.encode())
            part_of.writelines(strings)
            part_of.write(b"</sst>")
        for k in numbers:
            with file.open(f"xl/s{k}.xml", "w", force_zip64=True) as part_of:
                part_of.write(f'{head}<worksheet xmlns="{MAIN}"><sheetData>'.encode())
                part_of.writelines(rows)
                part_of.write(b"</sheetData></worksheet>")
    return path


NAMES = b'<row r="1"><c t="inlineStr"><is><t>u</t></is></c><c t="inlineStr"><is><t>y</t></is></c></row>'
NUMBERS = b"<row><c><v>1</v></c><c><v>2</v></c></row>"
TEXT = b'<row><c t="inlineStr"><is><t>' + b"x" * 30_000 + b"</t></is></c></row>"
ENTITIES = "<!DOCTYPE z [<!ENTITY a '" + "x" * 1000 + "'>"
ENTITIES += "".join(f"<!ENTITY {b} '{f'&{a};' * 30}'>" for a, b in zip("abcdef", "bcdefg", strict=True)) + "]>"
WORKBOOKS: dict[str, dict[str, Any]] = {
    "row": {"rows": [NAMES, b'<row r="2000000000"><c><v>1</v></c></row>']},
    "rows apart": {"rows": [NAMES, NUMBERS, b'<row r="2000000000"><c><v>1</v></c></row>']},
    "column": {"rows": [NAMES, NUMBERS, *[b'<row><c r="XFD9"><v>1</v></c></row>'] * 9000]},
    "far column": {"rows": [NAMES, b'<row><c r="ZZZZZZ9"><v>1</v></c></row>']},
    "inline strings": {"rows": [NAMES, *[TEXT] * 10_000]},
    "one string": {"rows": [NAMES, b'<row><c t="inlineStr"><is><t>', *[b"x" * (1 << 20)] * 350]},
    "blanks": {"rows": [NAMES, *[b" " * (1 << 20)] * 350]},
    "empty rows": {"rows": [NAMES, NUMBERS, *[b"<row/>" * 100_000] * 80]},
    "shared strings": {"rows": [NAMES, NUMBERS], "strings": [b"<si><t>" + b"y" * 30_000 + b"</t></si>"] * 10_000},
    "sheets": {"rows": [NAMES], "sheets": 3000},
    "entities": {"rows": [NAMES, b"<row><c t='inlineStr'><is><t>&g;</t></is></c></row>"], "head": ENTITIES},
}


@every("name", WORKBOOKS, quick=2)
def test_a_bomb_of_a_workbook(tmp_path: Path, name: str) -> None:
    pytest.importorskip("openpyxl")
    said = check(workbook(tmp_path / "log.xlsx", **WORKBOOKS[name]), samples=10_000)
    assert said or name in ("column",)


@pytest.mark.slow
def test_twenty_thousand_sheets_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    assert "20,005 files" in check(workbook(tmp_path / "log.xlsx", rows=[NAMES], sheets=20_000))


def test_a_number_that_leaves_float64_is_infinite(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    rows = [NAMES, NUMBERS, b"<row><c><v>" + b"9" * 400 + b"</v></c><c><v>2</v></c></row>"]
    assert read_columns(workbook(tmp_path / "log.xlsx", rows)).column("u").tolist() == [1.0, np.inf]


def test_a_workbook_discloses_no_file(tmp_path: Path) -> None:
    """An external entity is not resolved, in a text and in a number."""
    pytest.importorskip("openpyxl")
    (tmp_path / "secret").write_text("31337")
    entity = f'<!DOCTYPE z [<!ENTITY secret SYSTEM "file://{tmp_path}/secret">]>'
    cell = b"<row><c><v>&secret;</v></c><c><v>2</v></c></row>"
    named = b"<row><c t='inlineStr'><is><t>&secret;</t></is></c><c t='inlineStr'><is><t>y</t></is></c></row>"
    for rows in ([NAMES, NUMBERS, cell], [named, NUMBERS, NUMBERS]):
        path, said = workbook(tmp_path / "log.xlsx", rows, head=entity), ""
        try:
            table = read_columns(path)
            said = repr((table.names, table.columns(list(table.names))))
        except LogError as error:
            said = str(error)
        assert "31337" not in said


# --- HDF5


def hdf5(path: Path, fill: Callable[[Any], object]) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        fill(file)
    return path


def groups(file: Any, depth: int) -> None:
    for _ in range(depth):
        file = file.create_group("g")
    file["u"] = np.arange(9.0)


def inflating(file: Any, name: str, megabytes: int) -> None:
    """A chunk that claims 8 kB, and unpacks to far more."""
    import zlib

    data = file.create_dataset(name, (1024,), "f8", chunks=(1024,), compression="gzip")
    packer = zlib.compressobj(1)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(megabytes)) + packer.flush()
    data.id.write_direct_chunk((0,), packed)


def both(file: Any, make: Callable[[str], object]) -> None:
    for name in ("u", "y"):
        make(name)


HDF5: dict[str, Callable[[Any], object]] = {
    "groups": lambda file: groups(file, 3000),
    "unwritten": lambda file: both(file, lambda name: file.create_dataset(name, (10**11,), "f8", chunks=(1 << 20,))),
    "unwritten, whole": lambda file: both(file, lambda name: file.create_dataset(name, (10**11,), "f8")),
    "columns": lambda file: file.create_dataset("u", (1 << 18, 1 << 18), "i1", chunks=(1, 1)),
    "filter": lambda file: both(file, lambda name: inflating(file, name, 350)),
}


def one_chunk_of_many(file: Any, name: str) -> None:
    file.create_dataset(name, (10**11,), "f8", chunks=(1000,))[:1000] = 1.0


HDF5["partly written"] = lambda file: both(file, partial(one_chunk_of_many, file))


@every("name", HDF5, quick=1)
def test_a_bomb_of_hdf5(tmp_path: Path, name: str) -> None:
    assert check(hdf5(tmp_path / "log.h5", HDF5[name]))


def test_hdf5_discloses_no_file(tmp_path: Path) -> None:
    """Neither by external storage, nor by a virtual data set, nor by a link."""
    h5py = pytest.importorskip("h5py")
    secret = tmp_path / "secret"
    secret.write_bytes(np.full(9, 31337.0).tobytes())
    hdf5(tmp_path / "secret.h5", lambda file: file.create_dataset("u", data=np.full(9, 31337.0)))

    def fill(file: Any, *more: str) -> None:
        for name in more:
            file[name] = np.arange(9.0)
        file.create_dataset("outside", (9,), "f8", external=[(str(secret), 0, 72)])
        layout = h5py.VirtualLayout((9,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "u", (9,))
        file.create_virtual_dataset("virtual", layout)
        file["link"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "u")
        file["folder"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/")
        file["soft"] = h5py.SoftLink("/link")

    path = hdf5(tmp_path / "log.h5", lambda file: fill(file, "u", "y"))
    table = read_columns(path)
    assert table.names == ("u", "y")
    for name in ("outside", "virtual"):
        with pytest.raises(LogError, match=rf"log\.h5: {name} lies in another file, which is not read"):
            read_log(path, input="u", output=name, dt=1.0)
    with pytest.raises(LogError, match="lies in another file"):
        read_columns(hdf5(tmp_path / "alone.h5", fill))


# --- arrays and columns


def npy_header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})
    return file.getvalue()


def npz(path: Path, **members: Any) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, parts in members.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                file.writelines(parts)
    return path


def zeros(megabytes: int) -> list[bytes]:
    return [bytes(1 << 20)] * megabytes


NPZ: dict[str, dict[str, Any]] = {
    "claims": {"u": [npy_header((10**12,)), bytes(99)], "y": [npy_header((10**12,)), bytes(99)]},
    "no signal": {"cube": [npy_header((350, 1024, 128)), *zeros(350)]},
    "text": {"s": [npy_header((350 << 18,), "<U1"), *zeros(350)]},
    "objects": {"o": [npy_header((350 << 17,), "|O"), *zeros(350)]},
    "columns": {"u": [npy_header((1 << 18, 1 << 18), "|i1"), *zeros(1)]},
    "empty columns": {"u": [npy_header((0, 1 << 60)), *zeros(1)]},
    "no numbers": {name: [npy_header((100 << 17,)), *[b"\xff" * (1 << 20)] * 200] for name in ("u", "y")},
}


@every("name", NPZ, quick=1)
def test_a_bomb_of_numpy(tmp_path: Path, name: str) -> None:
    assert check(npz(tmp_path / "log.npz", **NPZ[name]))


def mat(path: Path, **variables: Any) -> Path:
    import scipy.io

    scipy.io.savemat(path, variables, do_compression=True)
    return path


@pytest.mark.slow
def test_a_bomb_of_matlab(tmp_path: Path) -> None:
    """Variables that are not signals are not loaded: a cube, a text, cells."""
    cells = np.full(50_000, 0.0, object)
    for variables in ({"cube": np.zeros((300, 1024, 1024), np.int8)}, {"cells": cells}, {"s": "x" * (60 << 20)}):
        assert check(mat(tmp_path / "log.mat", **variables))


@pytest.mark.slow
def test_a_bomb_of_parquet_or_arrow(tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    nulls = pa.table({name: pa.nulls(20_000_000, pa.float64()) for name in ("u", "y")})
    pq.write_table(nulls, tmp_path / "log.parquet", row_group_size=1 << 30)
    assert "values are missing" in check(tmp_path / "log.parquet")
    wide = pa.table({str(k): [1.0] for k in range(150_000)})
    with pa.ipc.new_file(tmp_path / "log.arrow", wide.schema) as file:
        file.write_table(wide)
    assert check(tmp_path / "log.arrow")
    text = pa.table({"u": [0.0, 1.0], "y": [0.0, 1.0], "s": [bytes(300 << 20), b""]})
    with pa.ipc.new_file(
        tmp_path / "log.arrow", text.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")
    ) as file:
        file.write_table(text)
    assert check(tmp_path / "log.arrow")


# --- what is no bomb

ROWS = 1_000_000


def constant(path: Path) -> Path:
    """A log of constant columns: a thousand times smaller than its samples."""
    u, y = np.zeros(ROWS), np.ones(ROWS)
    suffix = "".join(path.suffixes)
    if suffix in (".csv.gz", ".csv.zst"):
        text = b"u,y\n" + b"0,1\n" * ROWS
        path.write_bytes(gzip.compress(text) if suffix == ".csv.gz" else zst(iter([text])))
    elif suffix == ".npz":
        np.savez_compressed(path, u=u, y=y)
    elif suffix == ".mat":
        mat(path, u=u, y=y)
    elif suffix == ".h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            file.create_dataset("u", data=u, compression="gzip", chunks=True)
            file.create_dataset("y", data=y, compression="gzip", chunks=(ROWS,))
    else:
        pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        pq.write_table(pa.table({"u": u, "y": y}), path, compression="zstd", row_group_size=ROWS)
    return path


@every("suffix", [".csv.gz", ".csv.zst", ".npz", ".mat", ".h5", ".parquet"], quick=1)
def test_a_log_of_constant_columns_is_read(tmp_path: Path, suffix: str) -> None:
    path = constant(tmp_path / f"log{suffix}")
    assert path.stat().st_size < 2 * 8 * ROWS / 100
    assert check(path, samples=2 * ROWS) == ""


# --- what is no file


def test_a_pipe_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.csv")
    (tmp_path / "link.csv").symlink_to("/dev/zero")
    (tmp_path / "log.csv.gz").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "folder" / "part.parquet")
    for name in ("log.csv", "link.csv", "log.csv.gz", "folder"):
        with pytest.raises(LogError, match="a device, pipe or socket"):
            read_columns(tmp_path / name)
    (tmp_path / "circle.csv").symlink_to(tmp_path / "circle.csv")
    with pytest.raises(LogError, match=r"circle\.csv: cannot be read"):
        read_columns(tmp_path / "circle.csv")
