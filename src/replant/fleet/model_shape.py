"""The shape of a fleet's models: one structure, or one of each of several inputs, whose columns are named by it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from replant.errors import InvalidArgumentError
from replant.fitting.miso_fit import structures_of
from replant.model.structure import Structure
from replant.numerics.arguments import instance, iterable


@dataclass(frozen=True)
class RowShape:
    """A structure of each of several inputs; columns of the table end in a dot and the input's name."""

    structures: tuple[Structure, ...]
    inputs: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, those of one input after the other."""
        return tuple(f"{name}{end}" for _, end, structure in branches_of(self) for name in structure.names)

    @property
    def size(self) -> int:
        """How many parameters there are."""
        return sum(each.size for each in self.structures)

    @property
    def coefficients(self) -> int:
        """How many of them are coefficients: all."""
        return self.size

    def __str__(self) -> str:
        return ", ".join(f"{each} from {name}" for name, _, each in branches_of(self))


Shape = Structure | RowShape


def branches_of(shape: Shape) -> Iterator[tuple[str, str, Structure]]:
    """Yield of each input its name, how its columns end, and its structure; of a single one no name and no ending."""
    if isinstance(shape, Structure):
        yield "", "", shape
        return
    for name, structure in zip(shape.inputs, shape.structures, strict=True):
        yield name, f".{name}", structure


def shape_of(structure: Structure | tuple[Structure, ...], inputs: Any) -> Shape:
    """Return the shape of models of a structure, or of one for each of several inputs."""
    if isinstance(structure, Structure):
        return structure
    return RowShape(structure, tuple(map(str, inputs)))


def wanted(
    inputs: Any, structure: Structure | Sequence[Structure] | None, poles: Any, zeros: Any, delay: Any
) -> Structure | tuple[Structure, ...]:
    """Return the structure asked for, of several inputs a tuple of them.

    >>> [each.poles for each in wanted(["u1", "u2"], None, (2, 1), 0, 0.0)]
    [2, 1]
    """
    if not iterable(inputs):
        if poles is not None and iterable(poles):
            raise InvalidArgumentError(f"poles has {len(poles)} entries, and there is one input: name the others")
        return Structure.wanted(structure, poles, zeros, delay)  # type: ignore[arg-type]
    if structure is None:
        return structures_of(len(inputs), poles, zeros, delay)
    given = (structure,) if isinstance(structure, Structure) else tuple(structure)
    structures = tuple(instance("structure", each, Structure) for each in given)
    if len(structures) != len(inputs):
        raise InvalidArgumentError(f"structure must be one for each of {len(inputs)} inputs, got {len(structures)}")
    if any(each.bias or each.feedthrough for each in structures):
        raise InvalidArgumentError("several inputs take no bias and no feedthrough yet: leave them out")
    return structures
