"""Requests to the dashboard as bytes on the wire."""

from __future__ import annotations

import socket

from support.waiting import PATIENCE


def ask(port: int, line: str, *headers: str, host: str | None = "127.0.0.1") -> tuple[int, dict[str, str], bytes]:
    """Send a request with just these headers, and return status, headers in lower case, and body."""
    lines = [f"{line} HTTP/1.1", *([f"Host: {host}:{port}"] if host else []), *headers]
    lines += [] if "Connection: Upgrade" in headers else ["Connection: close"]
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as wire:
        wire.sendall(("\r\n".join(lines) + "\r\n\r\n").encode("latin-1"))
        answer = b"".join(iter(lambda: wire.recv(65536), b""))
    head, _, body = answer.partition(b"\r\n\r\n")
    first, *rest = head.decode("latin-1").split("\r\n")
    pairs = (line.partition(": ") for line in rest)
    return int(first.split()[1]), {name.lower(): value for name, _, value in pairs}, body
