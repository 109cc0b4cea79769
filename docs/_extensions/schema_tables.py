"""The directive `schema-table`: a JSON Schema of the package as a table of its entries."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docutils import nodes
from docutils.parsers.rst import Directive

import replant

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PACKAGE = Path(replant.__file__).parent
HEADINGS = ("entry", "type", "meaning")
WIDTHS = (3, 2, 4)
#: Names of entries that a schema gives by a pattern.
PATTERNS = {r"^(std_)?([ab][0-9]+(\..+)?|bias)$": "a0, b0, std_a0, .."}


@dataclass(frozen=True)
class Entry:
    """One entry of an object: its dotted path, its type in words, whether it is required, what it means."""

    path: str
    kind: str
    required: bool
    meaning: str

    @property
    def cells(self) -> tuple[str, str, str]:
        """The cells of its row, in the order of `HEADINGS`."""
        return self.path, self.kind if self.required else f"{self.kind}; may be absent", self.meaning


def entries(schema: dict[str, Any], path: str = "") -> Iterator[Entry]:
    """Yield the entries of an object, each before those of the object or of the array's items below it."""
    required = schema.get("required", [])
    patterns = {PATTERNS[pattern]: below for pattern, below in schema.get("patternProperties", {}).items()}
    for name, below in {**schema.get("properties", {}), **patterns}.items():
        at = f"{path}{name}"
        yield Entry(at, kind_of(below), name in required, meaning_of(below))
        yield from entries(below, f"{at}.")
        yield from entries(below.get("items", {}), f"{at}[].")
    other = schema.get("additionalProperties")
    if isinstance(other, dict) and other.get("properties"):
        yield from entries(other, f"{path}NAME.")


def resolved(schema: Any, root: dict[str, Any]) -> Any:
    """Return a schema with each reference replaced by what it names, and `null or object` by that object."""
    if isinstance(schema, list):
        return [resolved(one, root) for one in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return resolved(root["$defs"][schema["$ref"].rpartition("/")[2]], root)
    if "oneOf" in schema:
        inner = next(one for one in schema["oneOf"] if one.get("type") == "object")
        other = {name: one for name, one in schema.items() if name != "oneOf"}
        return resolved(inner | other | {"type": ["object", "null"]}, root)
    return {name: resolved(one, root) for name, one in schema.items() if name != "$defs"}


def kind_of(schema: dict[str, Any]) -> str:
    """Return the type that a schema allows, in words."""
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return ", ".join(json.dumps(value) for value in schema["enum"])
    if "anyOf" in schema:
        return " or ".join(kind_of(one) for one in schema["anyOf"])
    kinds = schema.get("type", "any")
    words = " or ".join([kinds] if isinstance(kinds, str) else kinds)
    items = schema.get("items")
    return words.replace("array", f"array of {kind_of(items)}") if items and items.get("type") != "object" else words


def meaning_of(schema: dict[str, Any]) -> str:
    """Return the description of an entry, or that of the items of an array."""
    return schema.get("description") or schema.get("items", {}).get("description", "")


def table_of(rows: list[tuple[str, ...]]) -> nodes.table:
    """Return a table with `HEADINGS` and rows of text; the first cell of a row is code."""
    group = nodes.tgroup(cols=len(HEADINGS))
    group += [nodes.colspec(colwidth=width) for width in WIDTHS]
    head, body = nodes.thead(), nodes.tbody()
    head += row_of([nodes.Text(text) for text in HEADINGS])
    body += [row_of([nodes.literal(row[0], row[0]), *map(nodes.Text, row[1:])]) for row in rows]
    group += [head, body]
    table = nodes.table(classes=["schema"])
    table += group
    return table


def row_of(cells: list[nodes.Node]) -> nodes.row:
    """Return a row with a cell for each node."""
    row = nodes.row()
    for cell in cells:
        row += nodes.entry("", nodes.paragraph("", "", cell))
    return row


class SchemaTable(Directive):
    """`{schema-table} fitting/schema/model-1.json`: a file of the package."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the description of the schema and its table."""
        path = PACKAGE / self.arguments[0]
        if not path.is_file():
            raise self.error(f"the package has no file {self.arguments[0]}")
        self.state.document.settings.env.note_dependency(str(path))
        schema = json.loads(path.read_text(encoding="utf-8"))
        return [
            nodes.paragraph(text=schema["description"].replace("`", "")),
            table_of([one.cells for one in entries(resolved(schema, schema))]),
        ]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("schema-table", SchemaTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
