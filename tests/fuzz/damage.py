"""Mutants of files: bits, bytes, cuts, splices, fields of lengths; within packed files too, their checksums right."""

from __future__ import annotations

import gzip
import io
import random
import struct
import zipfile

from fuzz.seeds_of_files import zstd

LENGTHS = [0, 1, 2, 3, 7, 8, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**16, 2**20, 2**24, 2**31 - 1, 2**31, 2**32 - 1]
WIDE = [2**32, 2**33, 2**40, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1]
TOKENS = [
    b",", b";", b"\t", b"\n", b"\r", b"\r\n", b'"', b"'", b"#", b"%", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3",
    b"nan", b"1e999", b"-1e-400", b"9" * 400, b"[" * 2000, b'{"a":' * 1500, b"}", b"]", b"null",
    b"true", b"0x1F", b"1_0",
    b"2024-13-45", b"24:61:00", b"2024-05-01T10:00:00", b"<", b"&amp;", b"<v>", b'r="2000000000"', b'r="XFD1"',
    b"1.234,5", b"A" * 3000, b"," * 3000, b"\n" * 3000, b"-9223372036854775809", b"18446744073709551616", b"\\ud800",
    b"Infinity",
]  # fmt: skip
TEXTS = {"model", "text", "jsonl"}


def mutant(name: str, seeds: list[bytes], chance: random.Random) -> bytes:
    """A file of a format with one damage or a few."""
    data = chance.choice(seeds)
    if chance.random() < 0.7:
        inside = _inside(name, data, chance, seeds)
        if inside is not None:
            return inside
    return damaged(data, chance, seeds, is_text=name in TEXTS)


def _inside(name: str, data: bytes, chance: random.Random, seeds: list[bytes]) -> bytes | None:
    """A packed file whose content is damaged; None if the format is not packed."""
    if name == "gz":
        return gzip.compress(damaged(gzip.decompress(data), chance, [], is_text=True), 1)
    if name == "zst":
        import zstandard

        whole = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        return zstd(damaged(whole, chance, [], is_text=True))
    if name in ("zip", "npz", "xlsx"):
        return _in_archive(data, chance, is_text=name != "npz")
    return None


def _in_archive(data: bytes, chance: random.Random, *, is_text: bool) -> bytes:
    file = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(data)) as old,
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new,
    ):
        names = old.namelist()
        wanted = chance.choice(names)
        for name in names:
            content = old.read(name)
            new.writestr(name, damaged(content, chance, [], is_text=is_text) if name == wanted else content)
    return file.getvalue()


def damaged(content: bytes, chance: random.Random, others: list[bytes], *, is_text: bool) -> bytes:
    """Bytes with one damage or a few."""
    data = bytearray(content)
    for _ in range(chance.choice([1, 1, 1, 2, 3, 5])):
        if not data:
            break
        at = chance.randrange(len(data))
        match chance.randrange(9 if not is_text else 12):
            case 0 | 1:
                data[at] ^= 1 << chance.randrange(8)
            case 2:
                data[at] = chance.choice([0, 1, 127, 128, 255, chance.randrange(256)])
            case 3 | 4:
                _put_length(data, at, chance)
            case 5:
                end = at + chance.choice([1, 2, 4, 8, 16, 64, 512])
                del data[at:end]
            case 6:
                source, start = chance.choice([content, *others]), 0
                start = chance.randrange(len(source))
                length = chance.choice([1, 4, 8, 32, 200])
                data[at : at + chance.choice([0, length])] = source[start : start + length]
            case 7:
                if chance.random() < 0.3:
                    del data[at:]
            case 8:
                data[at:at] = bytes([chance.choice([0, 255, 32])]) * chance.choice([1, 8, 100, 5000])
            case _:
                data[at : at + chance.choice([0, 0, 1, 3])] = chance.choice(TOKENS)
    return bytes(data)


def _put_length(data: bytearray, at: int, chance: random.Random) -> None:
    width, order = chance.choice([1, 2, 4, 8]), chance.choice("<>")
    at = at // width * width if chance.random() < 0.5 else at
    value = chance.choice(LENGTHS + (WIDE if width == 8 else [])) % 2 ** (8 * width)
    if chance.random() < 0.3 and at + width <= len(data):
        kind = {1: "B", 2: "H", 4: "I", 8: "Q"}[width]
        (old,) = struct.unpack_from(order + kind, data, at)
        value = (old + chance.choice([-1, 1, 2, 8, 100])) % 2 ** (8 * width)
    data[at : at + width] = value.to_bytes(width, "little" if order == "<" else "big")
