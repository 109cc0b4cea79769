"""The options of several inputs: the orders of each, and what cannot be combined with them yet."""

from __future__ import annotations

from typing import Any

from replant.cli.option_types import Each
from replant.errors import InvalidArgumentError

#: Options that one input takes, and several do not, with what they are without them.
NOT_YET = {
    "bias": False, "feedthrough": False, "input_map": "identity", "method": "auto",
    "optimizer": "auto", "full_trace": None, "background": False,
}  # fmt: skip


def are_several(options: dict[str, Any]) -> bool:
    """Return whether the options name several inputs or outputs."""
    return any(isinstance(options.get(name), tuple) for name in ("input_column", "output_column"))


def refuse_not_yet(options: dict[str, Any], several: str = "inputs") -> None:
    """Raise InvalidArgumentError for an option that several inputs, or outputs, do not take yet."""
    for name, usual in NOT_YET.items():
        if options.get(name, usual) != usual:
            raise InvalidArgumentError(
                f"several {several} take no --{name.removesuffix('_column').replace('_', '-')} yet"
            )


def orders_of(options: dict[str, Any], inputs: tuple[str, ...]) -> dict[str, tuple[Any, ...]]:
    """Return poles, zeros and dead time of each input: numbers, or ranges, each a tuple."""
    return {name: _of_each(options[name], name, inputs) for name in ("poles", "zeros", "delay")}


def is_range(given: Any) -> bool:
    """Return whether an order of several inputs has a range."""
    return any(isinstance(each, tuple) for each in given)


def numbers_of(options: dict[str, Any], inputs: tuple[str, ...]) -> dict[str, tuple[Any, ...]]:
    """Return poles, zeros and dead time of each input, where a range is refused."""
    refuse_not_yet(options)
    asked = orders_of(options, inputs)
    refuse_ranges(asked)
    return asked


def refuse_ranges(asked: dict[str, tuple[Any, ...]]) -> None:
    """Raise InvalidArgumentError where an order of an input is a range."""
    if any(map(is_range, asked.values())):
        raise InvalidArgumentError("a range is searched by replant fit: give a number for each input here")


def _of_each(given: tuple[Any, ...] | None, name: str, inputs: tuple[str, ...]) -> tuple[Any, ...]:
    """Return a number for each input, or a range: those given, or 0 for all."""
    if given is not None and len(given) > 1 and not isinstance(given, Each):
        return (given,) * len(inputs)
    example = ",".join("1" for _ in inputs)
    if given is None or (name != "poles" and given == (0.0,)):
        return (0,) * len(inputs)
    if len(given) != len(inputs) or not (isinstance(given, Each) or len(inputs) == 1):
        got = f"{len(given)} numbers" if isinstance(given, Each) else "one number"
        raise InvalidArgumentError(
            f"--{name} must have a number for each of {len(inputs)} inputs ({', '.join(inputs)}), as in {example}: "
            f"got {got}"
        )
    return tuple(given)
