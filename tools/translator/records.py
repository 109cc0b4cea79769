"""Tables of the schema in C: numbers by their names, ``s->ints->alarm``, and blocks as arrays, ``state_theta(s)``.

A struct lies over each of the flat arrays of a table, a field a slot.  What lies in one block depends on sizes that the
table itself has, so that a small function cuts it out.  Of an identifier's state there are three: one identifier, the
vectors of several, and one lane of these.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from translator.kinds import Array, Kind, Record, UnsupportedError

if TYPE_CHECKING:
    from translator.program import Program

REAL = {"d": "double {};", "l": "lanes {};", "s": "double {}[LANES];"}
BASE = {"d": "double", "l": "lanes", "s": "double"}
STRIDE = {"d": "", "l": "", "s": "LANES * "}
WHOLE = {"ints": Array("i", 1), "reals": Array("d", 1)}
BESIDE = {name: Array("d", 2) for name in ("banks", "buffer", "recent")}


def is_whole(table: Any) -> bool:
    """Whether a table has ``ints`` of its own, as the state has; else it is a block of another one."""
    return bool(table.integers)


def member(program: Program, code: str, kind: Record, name: str) -> tuple[str, Kind]:
    """Return a field of a table as C text, with its kind."""
    table = kind.table
    arrow = "->" if is_whole(table) else "."
    for slot in table.integers:
        if slot.name == name:
            return f"{code}{arrow}ints->{name}", "b" if type(slot).__name__ == "Flag" else "i"
    if name in {slot.name for slot in table.scalars}:
        own = f"{code}{arrow}reals->{name}"
        return (f"{own}[0]" if kind.element == "s" else own), "l" if kind.element == "l" else "d"
    if is_whole(table) and kind.element == "d" and name in BESIDE:
        return f"{code}->{name}", BESIDE[name]
    if name == "size" and not is_whole(table):
        return f"({_size(kind, table.blocks, {key: f'{code}.{key}' for key in sizes(kind)})})", "i"
    result = _block_kind(kind, name)
    program.type_of(result)
    program.members[kind, name] = result
    return f"{kind.prefix}_{name}({code})", result


def _block_kind(kind: Record, name: str) -> Kind:
    table = kind.table
    if is_whole(table) and (name in ("rows", "ints") or (kind.element == "d" and name == "reals")):
        return WHOLE.get(name, Array("i", 1))
    block = next((block for block in table.blocks if block.name == name), None)
    if block is None:
        raise UnsupportedError(f"no slot of {table.__name__} is called {name}")
    inner = getattr(block, "table", None)
    if inner is not None:
        return Record(inner, kind.element)
    element = "l" if kind.element == "l" else "d"
    return Array(element, len(block.shape.split(",")), strided=kind.element == "s")


def structs(kind: Record) -> str:
    """Return the definitions of a table's types."""
    table, lines = kind.table, []
    if is_whole(table) and kind.element == "d":
        names = [slot.name for slot in table.integers] + [f"at_{block.name}" for block in table.blocks]
        lines.append(_overlay(f"{kind.title}Ints", "int64_t {};", names))
    lines.append(_overlay(f"{kind.name}Reals", REAL[kind.element], [slot.name for slot in table.scalars]))
    if is_whole(table):
        own = f"{kind.title}Ints *ints; int64_t ints_size; {kind.name}Reals *reals;"
        own += " int64_t reals_size; reals2 banks, buffer, recent;" if kind.element == "d" else ""
    else:
        own = f"{kind.name}Reals *reals; " + " ".join(f"int64_t {name};" for name in sizes(kind))
    return "\n\n".join([*lines, f"typedef struct {{ {own} }} {kind.name};"])


def _overlay(name: str, field: str, names: list[str]) -> str:
    return "\n".join(["typedef struct {", *(f"    {field.format(each)}" for each in names), f"}} {name};"])


def sizes(kind: Record) -> list[str]:
    """Return the dimensions that a part's shapes are made of, but for those that are fixed."""
    fixed = kind.schema.FIXED
    words = {word for block in kind.table.blocks for axis in block.shape.split(",") for word in _words(axis)}
    return sorted(word for word in words if not word.isdigit() and word not in fixed)


def _words(axis: str) -> list[str]:
    return axis.replace("+", " ").replace("*", " ").split()


def accessor(program: Program, kind: Record, name: str, result: Kind) -> str:
    """Return the function that cuts a block out of a table."""
    head = f"INLINE {program.type_of(result)} {kind.prefix}_{name}(const {program.type_of(kind)} s)"
    return f"{head}\n{{\n    return ({program.type_of(result)}){{ {_cut(kind, name, result)} }};\n}}"


def _cut(kind: Record, name: str, result: Kind) -> str:
    schema = kind.schema
    if name == "rows" and is_whole(kind.table):
        return f"(int64_t *)s->ints + {schema.ROWS}, s->ints->batch_size"
    if name in WHOLE and is_whole(kind.table):
        return f"({'int64_t' if name == 'ints' else 'double'} *)s->{name}, s->{name}_size"
    block = next(block for block in kind.table.blocks if block.name == name)
    base, stride = BASE[kind.element], STRIDE[kind.element]
    if is_whole(kind.table):
        begin = f"({base} *)s->reals + {stride}s->ints->at_{name}"
        dimensions = {key: _sum(text, {}, "s->ints->") for key, text in schema.DIMENSIONS.items()}
    else:
        dimensions = {key: f"s.{key}" for key in sizes(kind)}
        before = [each for each in kind.table.blocks if each.index < block.index]
        begin = f"({base} *)s.reals + {stride}({_size(kind, before, dimensions)})"
    if isinstance(result, Record):
        inner = ", ".join(dimensions[key] for key in sizes(result))
        return f"({result.name}Reals *)({begin}), {inner}"
    axes = [_sum(axis, dimensions | {k: str(v) for k, v in schema.FIXED.items()}) for axis in block.shape.split(",")]
    return ", ".join([begin, *axes, *(["LANES"] if kind.element == "s" else [])])


def _sum(text: str, dimensions: dict[str, str], prefix: str = "") -> str:
    """Return a sum of products of dimensions as C."""
    terms = []
    for term in text.split("+"):
        factors = [factor.strip() for factor in term.split("*")]
        terms.append(" * ".join(each if each.isdigit() else dimensions.get(each, prefix + each) for each in factors))
    whole = " + ".join(terms)
    return f"({whole})" if len(terms) > 1 else whole


def _size(kind: Record, blocks: Any, dimensions: dict[str, str]) -> str:
    """Return how many numbers a part has up to the end of these blocks."""
    known = dimensions | {key: str(value) for key, value in kind.schema.FIXED.items()}
    products = (" * ".join(_sum(axis, known) for axis in block.shape.split(",")) for block in blocks)
    return " + ".join([str(len(kind.table.scalars)), *products])
