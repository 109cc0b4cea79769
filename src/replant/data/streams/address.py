"""Address: the parts of a source's URL; the message of a failed check says what to write."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from urllib.parse import SplitResult, parse_qsl, unquote, urlsplit

from replant.errors import InvalidArgumentError


@dataclass(frozen=True)
class Address:
    """The parts of a source's URL.

    Attributes
    ----------
    name : str
        The URL without password, for messages.
    scheme, host, path : str
        After a host, the path is without its first slash.
    port : int or None
    user, password : str or None
    options : dict
        The options ``name=value`` after the question mark.

    Examples
    --------
    >>> address = split("mqtt://lab:secret@10.0.0.7:1884/rig/1?qos=0")
    >>> address.name, address.host, address.port, address.path
    ('mqtt://lab@10.0.0.7:1884/rig/1?qos=0', '10.0.0.7', 1884, 'rig/1')
    >>> address.whole("qos", 1, least=0)
    0
    """

    name: str
    scheme: str
    host: str = ""
    port: int | None = None
    path: str = ""
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    options: dict[str, str] = field(default_factory=dict)

    def allow(self, *known: str) -> None:
        """Check that the source knows every option that is given."""
        for option in self.options:
            if option not in known:
                listed = ", ".join(known)
                raise InvalidArgumentError(f"{self.name}: unknown option {option!r}; known are: {listed}")

    def host_and_port(self, example: str) -> tuple[str, int]:
        """Return host and port."""
        if not self.host:
            raise InvalidArgumentError(f"{self.name}: the host is missing; write {example}")
        if self.port is None:
            raise InvalidArgumentError(f"{self.name}: the port is missing; write {example}")
        return self.host, self.port

    def whole(self, option: str, default: int, *, least: int) -> int:
        """Return an option as a whole number."""
        text = self.options.get(option, str(default))
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise InvalidArgumentError(
                f"{self.name}: {option} must be a whole number of at least {least}, got {text!r}; "
                f"write {option}={max(default, least)}"
            )
        return value

    def positive(self, option: str) -> float | None:
        """Return an option as a positive number, None where it is not given."""
        text = self.options.get(option)
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise InvalidArgumentError(
                f"{self.name}: {option} must be a positive number, got {text!r}; write {option}=1"
            )
        return value

    def one_of(self, option: str, choices: Collection[str], default: str) -> str:
        """Return an option that must be one of several words."""
        value = self.options.get(option, default)
        if value not in choices:
            listed = ", ".join(choices)
            raise InvalidArgumentError(f"{self.name}: {option} must be one of {listed}; got {value!r}")
        return value


def split(url: str) -> Address:
    """Return the parts of a URL that has a scheme and ``//``.

    >>> address = split("tcp://127.0.0.1:9000")
    >>> address.scheme, address.host, address.port
    ('tcp', '127.0.0.1', 9000)
    """
    try:
        parts = urlsplit(url)
    except ValueError as cause:
        raise InvalidArgumentError(f"{url}: not a URL ({cause}); write scheme://host:port") from None
    name = without_password(parts)
    try:
        port = parts.port
    except ValueError:
        raise InvalidArgumentError(f"{name}: the port must be a number from 0 to 65535") from None
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


def without_password(parts: SplitResult) -> str:
    """Return the URL without its password.

    Examples
    --------
    >>> without_password(urlsplit("mqtt://me:secret@rig/1")), without_password(urlsplit("serial:///dev/ttyUSB0"))
    ('mqtt://me@rig/1', 'serial:///dev/ttyUSB0')
    """
    url = parts.geturl() if parts.netloc else parts.geturl().replace(":", "://", 1)  # geturl leaves an empty host out
    return url if parts.password is None else url.replace(f":{parts.password}@", "@", 1)


def options_of(name: str, query: str) -> dict[str, str]:
    """Return the options that a query ``name=value&name=value`` holds; ``name`` is the URL, for the message.

    >>> options_of("demo", "speed=max&seed=3")
    {'speed': 'max', 'seed': '3'}
    """
    try:
        return dict(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
    except ValueError:
        raise InvalidArgumentError(
            f"{name}: options are written ?name=value&name=value after the address, not ?{query}"
        ) from None
