"""Opening: `open_source` finds the source of a URL and imports only that source's module."""

from __future__ import annotations

import importlib
from pathlib import Path

from replant.data.streams.address import Address, options_of, split
from replant.data.streams.rows import FIELDS
from replant.data.streams.source import Source
from replant.errors import InvalidArgumentError

#: For each scheme of a URL: the function that opens it, and an example.
SCHEMES = {
    "tcp": ("tcp.open_tcp", "tcp://127.0.0.1:9000"),
    "udp": ("udp.open_udp", "udp://0.0.0.0:9000"),
    "serial": ("serial_port.open_serial", "serial:///dev/ttyUSB0?baud=115200"),
    "mqtt": ("mqtt.open_mqtt", "mqtt://127.0.0.1:1883/rig/1"),
}
_OTHERS = "-, demo, log.csv?speed=10"


def open_source(url: str) -> Source:
    """Open a stream of live samples.

    =======================================  =========================================================================
    ``tcp://host:port``                      lines of a peer that listens
    ``udp://0.0.0.0:port``                   datagrams that come to a port of ours
    ``serial:///dev/ttyUSB0?baud=115200``    lines of a microcontroller; ``serial://COM3``
    ``mqtt://host:1883/topic``               messages of a topic; ``mqtt://user:password@host/topic?qos=1``
    ``-``                                    lines from standard input
    ``log.csv?speed=10``                     a recorded log; ``input``, ``output`` (u, y), ``reference``, ``time``,
                                             ``dt`` name its columns as `read_log` does; as fast as possible without
                                             ``speed``
    ``demo``                                 the simulated actuator in real time; ``demo?speed=max&seed=1``;
                                             ``demo?loop=pi``: under a controller, with its reference
    =======================================  =========================================================================

    Lines are CSV, of two fields ``u,y``, three ``t,u,y`` or four ``n,t,u,y`` (sequence number, time stamp in s, input,
    output) or as the URL's option says, ``?columns=n,u,y,r`` (r: reference); or they are JSON objects with these names.

    >>> source = open_source("demo?speed=max")
    >>> batch = next(filter(len, source.batches()))
    >>> batch.t[:3], batch.sequence[:3]
    (array([0.   , 0.001, 0.002]), array([0, 1, 2]))
    """
    address, opener = _address_of(url)
    module, _, function = opener.partition(".")
    source: Source = getattr(importlib.import_module(f"replant.data.streams.{module}"), function)(
        address, _columns_of(address)
    )
    return source


def _address_of(url: str) -> tuple[Address, str]:
    """Return the parts of a URL, and the name of the function that opens it."""
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
    address = Address(url, "", path=path, options=options_of(url, query))
    return address, {"-": "pipe.open_pipe", "demo": "demo.open_demo"}.get(path, "replay.open_replay")


def _columns_of(address: Address) -> tuple[str, ...] | None:
    """Return the column names of the option ``columns``, None where it is not given."""
    text = address.options.get("columns")
    if text is None:
        return None
    columns = tuple(name.strip() for name in text.split(","))
    if not {"u", "y"} <= set(columns) <= set(FIELDS) or len(set(columns)) < len(columns):
        raise InvalidArgumentError(
            f"{address.name}: columns={text} must name u and y, and may name n, t and r, each once; "
            "write columns=n,t,u,y"
        )
    return columns
