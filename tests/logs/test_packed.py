"""Compressed logs and logs from standard input."""

from __future__ import annotations

import gc
import gzip
import io
import json
import re
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.cli import main
from replant.errors import LogError
from replant.logs import Table, file_formats, read_columns, read_log
from replant.logs.merged_channels import Signal, channel_table
from support.cases import every
from support.damage import damaged

Write = Callable[..., Path]
TEXT = "t,u,y\n" + "".join(f"{k},{k % 5},{k / 7!r}\n" for k in range(200))


def zipped(**files: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return file.getvalue()


def zstd(content: bytes) -> bytes:
    packed: bytes = pytest.importorskip("zstandard").ZstdCompressor().compress(content)
    return packed


PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "log.csv.gz": gzip.compress,
    "LOG.CSV.GZ": gzip.compress,
    "log.csv.zst": zstd,
    "log.zip": lambda content: zipped(**{"folder/": b"", "folder/log.csv": content, "__MACOSX/folder/._log.csv": b"x"}),
}


IN_FRAMES: dict[str, Callable[[bytes], bytes]] = {
    "frames.csv.gz": lambda content: gzip.compress(content[:500]) + gzip.compress(content[500:]),
    "frames.csv.zst": lambda content: zstd(content[:500]) + zstd(content[500:]),
}


@every(("name", "pack"), (PACKERS | IN_FRAMES).items(), ids=PACKERS | IN_FRAMES)
def test_a_compressed_log_is_read_as_the_log(write: Write, name: str, pack: Callable[[bytes], bytes]) -> None:
    path = write(pack(TEXT.encode()), name)
    log, plain = read_log(path, input="u", output="y"), read_log(write(TEXT), input="u", output="y")
    assert (log.path, log.dt, log.input_name) == (path, plain.dt, plain.input_name)
    np.testing.assert_array_equal(log.output, plain.output)
    assert read_columns(path).column("t").tolist() == list(range(200))


def test_every_format_may_be_compressed(write: Write) -> None:
    file = io.BytesIO()
    np.savez(file, t=np.arange(9.0), u=np.ones(9), y=np.zeros(9))
    assert read_log(write(gzip.compress(file.getvalue()), "log.npz.gz"), input="u", output="y").dt == 1.0


@every(("name", "pack"), PACKERS.items(), ids=PACKERS)
def test_errors_name_the_file_that_was_given(write: Write, name: str, pack: Callable[[bytes], bytes]) -> None:
    path = write(pack(TEXT.replace("\n9,", "\n9,x").encode()), name)
    with pytest.raises(LogError, match=r"line 11, column 'u': 'x4' is not a number") as caught:
        read_log(path, input="u", output="y")
    assert str(caught.value).startswith(f"{path}: ")
    path = write(pack(TEXT.replace("\n9,", "\n8,").encode()), name)
    with pytest.raises(LogError, match=r"line 11, column 't': the time stamp 8 repeats") as caught:
        read_log(path, input="u", output="y")
    assert str(caught.value).startswith(f"{path}: ")
    with pytest.warns(UserWarning, match=re.escape(f"{path}: the last line is cut off")):
        read_log(write(pack(TEXT[:-22].encode()), name), input="u", output="y")


def test_errors_about_the_stamps_of_a_channel_name_it_too(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(copy: Path) -> Table:
        def fails() -> Signal:
            raise LogError(f"{copy}: damaged")

        return channel_table(copy, [("u", fails)])

    monkeypatch.setattr(file_formats, "_read_file", opened)
    path = write(gzip.compress(b"channels"), "log.mcap.gz")
    table = read_columns(path)
    assert table.stamps is not None
    with pytest.raises(LogError, match=rf"^{re.escape(str(path))}: damaged$"):
        table.stamps(0)


REFUSED = {
    "several files": (
        "log.zip",
        zipped(a=b"1", b=b"2"),
        "the archive has 2 files; unpack it, and give one of: a, b",
    ),
    "no file": ("log.zip", zipped(), "the archive has no file in it"),
    "packed twice": ("log.zip", zipped(**{"log.csv.gz": b"1"}), "holds another compressed file, log.csv.gz; unpack it"),
    "twice by name": ("log.gz.gz", gzip.compress(b"1"), "holds another compressed file, log.gz; unpack it first"),
    "unknown": ("log.ods.gz", gzip.compress(b"1"), "unknown file type '.ods'; a log is one of .csv"),
    "no suffix": ("log.gz", gzip.compress(b"1"), "unknown file type ''; a log is one of .csv"),
    "empty": ("log.csv.gz", b"", "the file is empty; record the log again"),
    "empty inside": ("log.csv.gz", gzip.compress(b""), "the file is empty; record the log again"),
    "not gzip": ("log.csv.gz", TEXT.encode(), "not a readable gzip file (Not a gzipped file"),
    "cut gzip": ("log.csv.gz", gzip.compress(TEXT.encode())[:-20], "not a readable gzip file"),
    "not zip": ("log.zip", TEXT.encode(), "not a readable zip archive (File is not a zip file); pack or copy the log"),
    "not zstd": ("log.csv.zst", TEXT.encode(), "not a readable Zstandard file"),
}


@every(("name", "content", "message"), REFUSED.values(), ids=REFUSED)
def test_a_file_that_cannot_be_unpacked_is_refused_in_one_line(
    write: Write, name: str, content: bytes, message: str
) -> None:
    if name.endswith("zst"):
        pytest.importorskip("zstandard")
    path = write(content, name)
    with pytest.raises(LogError, match=re.escape(message)) as caught:
        read_columns(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore:.* cut off .* left out:UserWarning")
@every(("name", "pack"), PACKERS.items(), ids=PACKERS)
def test_damaged_bytes_are_noticed(write: Write, name: str, pack: Callable[[bytes], bytes]) -> None:
    """Gzip, zip and Zstandard frames of more than one block have checksums, or say where they end."""
    whole = pack(TEXT.encode())
    for seed in range(60):
        path = write(damaged(whole, seed), name)
        message = ""
        try:
            read_log(path, input=1, output=2, dt=1.0)
        except LogError as error:
            message = str(error)
        assert not message or (message.startswith(f"{path}: ") and "\n" not in message)


def test_a_cut_zstandard_file_is_noticed(write: Write) -> None:
    whole = zstd(TEXT.encode())
    for length in range(5, len(whole), 50):
        with pytest.raises(LogError, match="not a readable Zstandard file"):
            read_columns(write(whole[:length], "log.csv.zst"))


def test_the_copy_is_removed_with_the_table(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    table = read_columns(write(gzip.compress(TEXT.encode()), "log.csv.gz"))
    gc.collect()
    assert len(list((tmp_path / "temporary").iterdir())) == 1
    assert len(table.column("u")) == len(table.column("y")) == 200
    del table
    gc.collect()
    assert list((tmp_path / "temporary").iterdir()) == []


# --- standard input


def pipe(monkeypatch: pytest.MonkeyPatch, content: bytes) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))


def record() -> str:
    u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 60), 5)
    y = [0.0]
    for value in u[:-1].tolist():
        y.append(0.9 * y[-1] + 0.1 * value)
    return "t,u,y\n" + "".join(f"{k / 10},{a},{b!r}\n" for k, (a, b) in enumerate(zip(u.tolist(), y, strict=True)))


@pytest.mark.parametrize("command", ["run", "fit"])
def test_a_command_reads_standard_input(
    command: str, write: Write, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--input", "u", "--output", "y", "--poles", "1", "--json"]
    pipe(monkeypatch, record().encode())
    main([command, "-", *options])
    piped = json.loads(capsys.readouterr().out)
    main([command, str(write(record())), *options])
    assert piped["num"] == json.loads(capsys.readouterr().out)["num"]


@pytest.mark.parametrize(
    ("more", "options", "note"),
    [
        ("30.0,1.", (), "the last line is cut off ('30.0,1.') and left out\n"),
        ("", ("--dt", "0.2"), "column 't' steps by 0.1 s, but --dt is 0.2 s; --dt is used"),
    ],
    ids=["a line that is left out", "a clock that contradicts"],
)
def test_what_is_noted_of_standard_input_is_said_on_standard_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], more: str, options: tuple[str, ...], note: str
) -> None:
    pipe(monkeypatch, (record() + more).encode())
    main(["fit", "-", "--input", "u", "--output", "y", "--poles", "1", "--json", *options])
    captured = capsys.readouterr()
    assert f"replant: note: -: {note}" in captured.err
    assert json.loads(captured.out)["samples"] == 300


@pytest.mark.parametrize(
    ("content", "is_terminal", "message"),
    [
        (b"", False, "-: the file is empty"),
        (b"\0\1", False, "-: not a text file"),
        (b"", True, "standard input: a log is to be piped into it"),
    ],
)
def test_standard_input_that_is_not_text_or_a_terminal_is_refused(
    monkeypatch: pytest.MonkeyPatch, content: bytes, is_terminal: bool, message: str
) -> None:
    pipe(monkeypatch, content)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: is_terminal)
    with pytest.raises(LogError, match=message):
        read_columns("-")
