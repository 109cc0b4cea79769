"""The architecture as the imports tell it: folders, levels, arrows; and the picture in docs/architecture.md.

    python tools/architecture.py [--source src/replant] [--picture docs/pictures/architecture.svg | --check]

A *room* is a folder of the package, or a module at its top.  An *arrow* leads from a room to one that it imports.  The
*level* of a room is the length of the longest chain of arrows below it.
"""

from __future__ import annotations

import argparse
import ast
import html
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "replant"
PICTURE = ROOT / "docs" / "pictures" / "architecture.svg"

Graph = Mapping[str, set[str]]


@dataclass(frozen=True, eq=False)
class Package:
    """The modules of a package, by their names below it: ``kernels.schema``, ``report`` for its ``__init__``."""

    source: Path
    files: Mapping[str, Path]
    trees: Mapping[str, ast.Module]

    @classmethod
    def read(cls, source: Path = SOURCE) -> Package:
        """Read every module below a folder."""
        files = {name_of(path, source): path for path in sorted(source.rglob("*.py"))}
        trees = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in files.items()}
        return cls(source, files, trees)

    def imports(self, tree: ast.AST, module: str, *, late: bool = True) -> Iterator[str]:
        """Every module that a tree imports, by its full name; without ``late`` those that importing it runs."""
        for node in ast.iter_child_nodes(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and not late:
                continue
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test) and not late:
                continue
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = self._base(node, module)
                for alias in node.names:
                    full = f"{base}.{alias.name}"
                    yield full if full.removeprefix("replant.") in self.files else base
            else:
                yield from self.imports(node, module, late=late)

    def _base(self, node: ast.ImportFrom, module: str) -> str:
        base = node.module or ""
        if node.level:  # relative to the module's package
            package = ("replant." + module).split(".")
            if self.files[module].name != "__init__.py":
                package = package[:-1]
            base = ".".join([*package[: len(package) - node.level + 1], *filter(None, [base])])
        return base

    def own(self, module: str, *, late: bool = True) -> set[str]:
        """The modules of the package that one imports, ``__init__`` for the package itself."""
        found = self.imports(self.trees[module], module, late=late)
        names = {name for name in found if name.partition(".")[0] == "replant"}
        return {name.removeprefix("replant").removeprefix(".") or "__init__" for name in names} - {module}

    def outside(self, module: str, *, late: bool = True) -> set[str]:
        """The top-level names of other packages that a module imports."""
        return {name.partition(".")[0] for name in self.imports(self.trees[module], module, late=late)} - {"replant"}

    def room(self, module: str) -> str:
        """The folder that a module lies in; a module at the top is a room of its own."""
        if self.files[module].name == "__init__.py":
            return module
        return module.rpartition(".")[0] or module

    def rooms(self, *, top: bool = False) -> dict[str, set[str]]:
        """Each room with those that it imports; ``top``: what lies deeper counts as part of the folder at the top."""
        graph: dict[str, set[str]] = {}
        for module in self.files:
            room = self.room(module).partition(".")[0] if top else self.room(module)
            graph.setdefault(room, set())
            for imported in self.own(module):
                other = self.room(imported).partition(".")[0] if top else self.room(imported)
                graph[room] |= {other} - {room}
        return graph

    def modules(self) -> dict[str, set[str]]:
        """Each module with those that it imports."""
        return {module: self.own(module) for module in self.files}


def name_of(path: Path, source: Path) -> str:
    """Return ``filters``, ``kernels.schema``, ``report`` for its ``__init__``."""
    parts = path.relative_to(source).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def circle(graph: Graph) -> set[str]:
    """Return the names that are left when all that need nothing of the rest are taken away; empty: no circle."""
    remaining = {name: needs - {name} for name, needs in graph.items()}
    while free := {name for name, needs in remaining.items() if not needs & set(remaining)}:
        remaining = {name: needs for name, needs in remaining.items() if name not in free}
    return set(remaining)


def levels(graph: Graph) -> dict[str, int]:
    """Return the level of each name of a graph without circles."""
    found: dict[str, int] = {}

    def level(name: str) -> int:
        if name not in found:
            found[name] = 1 + max((level(below) for below in graph[name]), default=-1)
        return found[name]

    for name in graph:
        level(name)
    return found


def reduced(graph: Graph) -> dict[str, set[str]]:
    """Return a graph without the arrows that follow from others."""

    @cache
    def below(name: str) -> set[str]:
        return graph[name].union(*(below(other) for other in graph[name]))

    return {
        name: {other for other in needs if not any(other in below(third) for third in needs - {other})}
        for name, needs in graph.items()
    }


def figures(package: Package) -> list[tuple[str, str]]:
    """Return what is counted, and how much of it."""
    rows = []
    for what, graph in (
        ("folders and modules at the top", package.rooms(top=True)),
        ("folders", package.rooms()),
        ("modules", package.modules()),
    ):
        stuck = circle(graph)
        depth = "-" if stuck else str(1 + max(levels(graph).values()))
        arrows = sum(len(needs) for needs in graph.values())
        rows.append((what, f"{len(graph)}, {arrows} arrows, {depth} levels, {len(stuck)} in circles"))
    lines = {name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in package.files.items()}
    functions = {
        f"{name}.{node.name}": (node.end_lineno or 0) - node.lineno + 1 - (ast.get_docstring(node) or "").count("\n")
        for name, tree in package.trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    rows.append(("lines", f"{sum(lines.values()):,}"))
    rows.append(("files over 300 lines", ", ".join(f"{n} {k}" for n, k in sorted(lines.items()) if k > 300) or "none"))
    longest = max(functions, key=lambda name: functions[name])
    rows.append(("longest function", f"{longest}, {functions[longest]} lines without its docstring"))
    return rows


# --- the picture

WIDTH, HEIGHT, GAP_X, GAP_Y, MARGIN = 150, 44, 18, 34, 20


def picture(package: Package) -> str:
    """Return the folders at the top as SVG: what is imported lies lower; no arrow that follows from others."""
    graph = {name: needs for name, needs in package.rooms(top=True).items() if not name.startswith("__")}
    graph = {name: needs & set(graph) for name, needs in graph.items()}
    if stuck := circle(graph):
        raise SystemExit(f"no picture: the imports make a circle among {', '.join(sorted(stuck))}")
    level, arrows = levels(graph), reduced(graph)
    rows = [sorted(name for name in graph if level[name] == k) for k in range(max(level.values()), -1, -1)]
    width = max(len(row) for row in rows) * (WIDTH + GAP_X) - GAP_X + 2 * MARGIN
    height = len(rows) * (HEIGHT + GAP_Y) - GAP_Y + 2 * MARGIN
    at: dict[str, tuple[float, float]] = {}
    for k, row in enumerate(rows):
        left = (width - len(row) * (WIDTH + GAP_X) + GAP_X) / 2
        for i, name in enumerate(row):
            at[name] = left + i * (WIDTH + GAP_X), MARGIN + k * (HEIGHT + GAP_Y)
    body = [_arrow(at[name], at[other]) for name in sorted(arrows) for other in sorted(arrows[name])]
    body += [_box(package, name, *at[name]) for name in sorted(at)]
    return "\n".join([_HEAD.format(width=width, height=height), *body, "</svg>", ""])


_HEAD = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"
 font-family="system-ui, sans-serif" role="img" aria-label="The folders of replant; what is imported lies lower">
<style>
 rect.page {{ fill: #ffffff }} rect.room {{ fill: #eef3f8; stroke: #4a6a8a }}
 rect.single {{ fill: #ffffff; stroke: #9aa7b4 }}
 text {{ fill: #16222e; font-size: 13px; text-anchor: middle }} text.within {{ fill: #4d5b69; font-size: 9.5px }}
 path {{ fill: none; stroke: #9aa7b4; stroke-width: 1 }}
</style>
<rect class="page" width="{width}" height="{height}"/>"""


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    x, y = start[0] + WIDTH / 2, start[1] + HEIGHT
    u, v = end[0] + WIDTH / 2, end[1]
    bend = (v - y) / 2
    return f'<path d="M{x:g} {y:g} C{x:g} {y + bend:g} {u:g} {v - bend:g} {u:g} {v:g}"/>'


def _box(package: Package, name: str, x: float, y: float) -> str:
    folders = sorted({package.room(m).split(".")[1] for m in package.files if package.room(m).startswith(name + ".")})
    kind = "room" if package.files[name].name == "__init__.py" else "single"
    middle = x + WIDTH / 2
    lines = [", ".join(folders[:3]), ", ".join(folders[3:])] if folders else []
    lines = [line for line in lines if line]
    first = y + HEIGHT / 2 + 5 - 6 * len(lines)
    text = [f'<text x="{middle:g}" y="{first:g}">{html.escape(name)}</text>']
    text += [
        f'<text class="within" x="{middle:g}" y="{first + 12 * (i + 1):g}">{line}</text>'
        for i, line in enumerate(lines)
    ]
    return f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="5"/>' + "".join(text)


def main() -> None:
    """Print the figures; write the picture where one is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", type=Path, default=SOURCE, help="the package's folder")
    parser.add_argument("--picture", type=Path, help="write the SVG here")
    parser.add_argument("--check", action="store_true", help="whether the picture of the docs is the present one")
    options = parser.parse_args()
    package = Package.read(options.source)
    if options.check:
        if PICTURE.read_text(encoding="utf-8") != picture(package):
            raise SystemExit(f"{PICTURE.relative_to(ROOT)} is not the present one: make pages")
        return
    for what, how_much in figures(package):
        print(f"{what}: {how_much}")
    if options.picture:
        options.picture.write_text(picture(package), encoding="utf-8")


if __name__ == "__main__":
    main()
