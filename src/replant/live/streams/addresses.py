"""The parts of a source's address; `open_source` opens the source and imports only its module."""

from __future__ import annotations

import contextlib
import importlib
import math
import os
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qsl, unquote, urlsplit

from replant.errors import InvalidArgumentError, LogError
from replant.live.streams.reader_thread import Source
from replant.live.streams.source import UY, Columns, Signals


@dataclass(frozen=True)
class Address:
    """The parts of a source's URL."""

    name: str  # the URL without password, for messages
    scheme: str  # scheme, host, path: after a host, the path has no leading slash
    host: str = ""
    port: int | None = None
    path: str = ""
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    options: dict[str, str] = field(default_factory=dict)  # the options ``name=value`` after the question mark

    def allow(self, *known: str) -> None:
        """Check that the source knows all options given."""
        for option in self.options:
            if option not in known:
                listed = ", ".join(known)
                raise InvalidArgumentError(f"{self.name}: unknown option {option!r}; known are: {listed}")

    def check(self, part: object, what: str) -> None:
        """Check that a part of the address is given."""
        if not part:
            raise InvalidArgumentError(f"{self.name}: the {what} is missing; write {SCHEMES[self.scheme][1]}")

    @property
    def place(self) -> tuple[str, int]:
        """Host and port."""
        self.check(self.host, "host")
        self.check(self.port is not None, "port")
        return self.host, self.port or 0

    def number(self, option: str, *, least: int | None = None, example: int = 1) -> float | None:
        """Return an option as a positive number, or as a whole number of at least ``least``; None if not given."""
        text = self.options.get(option)
        if text is None:
            return None
        with contextlib.suppress(ValueError):
            value = float(text) if least is None else int(text)
            if 0.0 < value < math.inf if least is None else value >= least:
                return value
        what = "a positive number" if least is None else f"a whole number of at least {least}"
        raise InvalidArgumentError(f"{self.name}: {option} must be {what}, got {text!r}; write {option}={example}")

    def one_of(self, option: str, choices: Collection[str], default: str) -> str:
        """Return an option that must be one of several words."""
        value = self.options.get(option, default)
        if value not in choices:
            listed = ", ".join(choices)
            raise InvalidArgumentError(f"{self.name}: {option} must be one of {listed}; got {value!r}")
        return value


NO_PORT = "the port must be a number from 0 to 65535"


def split(url: str) -> Address:
    """Return the parts of a URL that has a scheme and ``//``."""
    try:
        parts = urlsplit(url)
    except ValueError as cause:
        raise InvalidArgumentError(f"{url}: not a URL ({cause}); write scheme://host:port") from None
    name = parts.geturl() if parts.netloc else parts.geturl().replace(":", "://", 1)  # geturl omits an empty host
    if parts.password is not None:
        name = name.replace(f":{parts.password}@", "@", 1)
    try:
        port = parts.port
    except ValueError:
        raise InvalidArgumentError(f"{name}: {NO_PORT}") from None
    return Address(
        name,
        parts.scheme.lower(),
        parts.hostname or "",
        port,
        unquote(parts.path).removeprefix("/") if parts.netloc else unquote(parts.path),
        None if parts.username is None else unquote(parts.username),
        None if parts.password is None else unquote(parts.password),
        options_of(name, parts.query),
    )


def options_of(name: str, query: str) -> dict[str, str]:
    """Return the options in a query ``name=value&name=value``; ``name`` is the URL, for the message."""
    try:
        return dict(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
    except ValueError:
        raise InvalidArgumentError(
            f"{name}: options are written ?name=value&name=value after the address, not ?{query}"
        ) from None


#: For each scheme of a URL: the class or function that opens it, and an example.
SCHEMES = {
    "tcp": ("serial_and_network.TcpSource", "tcp://127.0.0.1:9000"),
    "udp": ("serial_and_network.UdpSource", "udp://0.0.0.0:9000"),
    "serial": ("serial_and_network.SerialSource", "serial:///dev/ttyUSB0?baud=115200"),
    "mqtt": ("serial_and_network.MqttSource", "mqtt://127.0.0.1:1883/rig/1"),
}
REPLAY = "demo.open_replay"  # what opens a recorded log
_OTHERS = "-, demo, log.csv?speed=10"


def open_source(url: str, signals: Signals = UY) -> Source:
    """Open a stream of live samples; ``signals`` names the fields of its lines or columns, see docs/live.md.

    >>> source = open_source("demo?speed=max")
    >>> batch = next(filter(len, source.batches()))
    >>> batch.t[:3], batch.sequence[:3]
    (array([0.   , 0.001, 0.002]), array([0, 1, 2]))
    """
    address, opener = parts_of(url)
    module, _, opens = opener.partition(".")
    source: Source = getattr(importlib.import_module(f"replant.live.streams.{module}"), opens)(
        address, _columns_of(address, signals), signals
    )
    return source


def parts_of(url: str) -> tuple[Address, str]:
    """Return the parts of a URL, and the name of the class or function that opens it."""
    scheme, separator, _ = url.partition("://")
    if separator:
        if scheme.lower() in SCHEMES:
            return split(url), SCHEMES[scheme.lower()][0]
        examples = ", ".join(example for _, example in SCHEMES.values())
        raise InvalidArgumentError(f"{url}: unknown scheme {scheme!r}; known are {examples}, {_OTHERS}")
    path, mark, query = url.rpartition("?")
    if not mark or Path(url).exists():
        path, query = url, ""
    if not path:
        raise InvalidArgumentError(f"{url!r}: the source is missing; write {SCHEMES['tcp'][1]}, {_OTHERS}")
    opener = {"-": "serial_and_network.PipeSource", "demo": "demo.open_demo"}.get(path, REPLAY)
    if opener == REPLAY and not os.path.exists(path):  # noqa: PTH110 - Path raises for some names
        raise LogError(f"{path}: no such file; check the path")
    return Address(url, "", path=path, options=options_of(url, query)), opener


def _columns_of(address: Address, signals: Signals) -> Columns:
    """Return the column names of the option ``columns``; None if it is not given."""
    text = address.options.get("columns")
    if text is None:
        return None
    columns = tuple(name.strip() for name in text.split(","))
    if not signals.are_in(columns):
        raise InvalidArgumentError(
            f"{address.name}: columns={text} must name {', '.join(signals.inputs)} and {signals.output}, and may name "
            f"n, t and r, each once; write columns={','.join(signals.fields[:-1])}"
        )
    return columns
