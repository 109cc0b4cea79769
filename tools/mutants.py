"""Mutants: single lines of the package are changed one at a time, and the tests have to notice.

`python tools/mutants.py --sample 100` draws lines evenly over the areas below and changes one comparison, sign, factor,
constant or condition of each, in a copy of the repository.  Its examples and the tests that import the changed module
run first, then those of its folder, then those of the folders that use it, then all of `make test`, up to the first
failure.  A mutant that no test notices survives: it is printed as a difference, and the share of those killed with its
interval (Wilson, 95 %).  Each result is a line of out/mutants/results.jsonl.

Mutants that do the same as the line are not drawn: tools/equivalent_mutants.toml has them, each with its proof.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from math import sqrt
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = Path("src/replant")
OUT = ROOT / "out/mutants"
EQUIVALENT = ROOT / "tools/equivalent_mutants.toml"
#: Folders of the source that are drawn from, the folders of tests that have to notice, and those that use the code.
AREAS = {
    "core": (
        ["numerics", "model", "estimation", "online", "verdict"],
        ["{folder}"],
        ["fitting", "online", "verdict"],
    ),
    "kernels": (
        ["kernels"],
        ["kernels", "estimation/optimizers", "estimation/engine", "online/test_identifier.py"],
        ["online"],
    ),
    "logs": (["logs"], ["logs"], ["cli"]),
    "streams": (["live/streams"], ["live/streams"], ["live"]),
    "live": (["live"], ["live"], []),
    "fleet": (["fleet"], ["fleet", "cli/test_fleet.py"], []),
}
#: Processor time of a process, time of a test and of a run, in s: a mutant may make a loop or a wait without end, which
#: is noticed too.
MOST_WORK, LONGEST_TEST, LONGEST = 300, 300, 7200
SWAPPED: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Add,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


def mutants_of(node: ast.AST) -> Iterator[ast.AST]:
    """The changes of one expression."""
    if isinstance(node, ast.Compare):
        for at, sign in enumerate(node.ops):
            if type(sign) in SWAPPED:
                changed = copy.deepcopy(node)
                changed.ops[at] = SWAPPED[type(sign)]()
                yield changed
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in SWAPPED:
        other = copy.deepcopy(node)
        other.op = SWAPPED[type(node.op)]()
        yield other
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield ast.Constant(2 * node.value if node.value else 1.0)


def expressions(node: ast.AST) -> Iterator[ast.AST]:
    """What may be changed: no annotation, no text, no message of an exception, no decorator.

    Nor the numbers that are named at the top of a module: what changes with those `make sensitivity` measures.
    """
    if isinstance(node, ast.Raise) or (isinstance(node, ast.keyword) and node.arg == "strict"):
        return
    if isinstance(node, ast.Assign | ast.AnnAssign):
        (target, *_) = node.targets if isinstance(node, ast.Assign) else [node.target]
        if ast.unparse(target).isupper():
            return
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield child
                yield from expressions(child)


def changes(path: Path) -> Iterator[tuple[int, str]]:
    """Every mutant of a module: the number of the line, from 1, and the line as it becomes."""
    text = (ROOT / path).read_text(encoding="utf-8")
    lines = text.splitlines()
    for node in expressions(ast.parse(text)):
        if getattr(node, "lineno", 0) == 0 or node.lineno != node.end_lineno:  # type: ignore[attr-defined]
            continue
        for changed in mutants_of(node):
            line = lines[node.lineno - 1].encode()  # type: ignore[attr-defined]
            begin, end = node.col_offset, node.end_col_offset  # type: ignore[attr-defined]
            new = ast.unparse(changed)
            new = new if isinstance(node, ast.AugAssign) else f"({new})"
            yield node.lineno, (line[:begin] + new.encode() + line[end:]).decode()  # type: ignore[attr-defined]


def proved() -> set[tuple[str, str, str]]:
    """The mutants that do the same as the line: the module, the line, and the line as it becomes, without indents."""
    return {
        (name, each["line"], each["becomes"])
        for name, of_module in tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).items()
        for each in of_module
    }


def outdated(equivalent: set[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """Those that no module has any more: the line was changed, and the proof with it is to be looked at again."""
    found: set[tuple[str, str, str]] = set()
    for name in {name for name, *_ in equivalent if (ROOT / SOURCE / name).exists()}:
        lines = (ROOT / SOURCE / name).read_text(encoding="utf-8").splitlines()
        found |= {(name, lines[line - 1].strip(), new.strip()) for line, new in changes(SOURCE / name)}
    return sorted(equivalent - found)


def drawn(sample: int, seed: int, areas: list[str]) -> Iterator[dict[str, Any]]:
    """As many mutants of each area, each of another line."""
    generator, equivalent = random.Random(seed), proved()
    for number, area in enumerate(areas):
        files = sorted(
            path.relative_to(ROOT)
            for name in AREAS[area][0]
            for path in ([ROOT / SOURCE / name] if name.endswith(".py") else (ROOT / SOURCE / name).rglob("*.py"))
        )
        found = [(path, *change) for path in files for change in changes(path)]
        lines: dict[tuple[Path, int], list[str]] = {}
        texts = {path: (ROOT / path).read_text(encoding="utf-8").splitlines() for path in files}
        for path, line, new in found:
            name = path.relative_to(SOURCE).as_posix()
            if (name, texts[path][line - 1].strip(), new.strip()) not in equivalent:
                lines.setdefault((path, line), []).append(new)
        for path, line in generator.sample(
            sorted(lines), sample * (number + 1) // len(areas) - sample * number // len(areas)
        ):
            yield {"area": area, "path": str(path), "line": line, "new": generator.choice(lines[path, line])}


def tests_for(area: str, path: Path, near_only: bool) -> list[list[str]]:
    """The runs of tests that have to notice a change of a module: what knows it, its folders, what uses it, all."""
    module = ".".join(path.with_suffix("").parts[1:])
    inside = path.relative_to(SOURCE)
    folders = [f"tests/{name.format(folder=inside.parts[0])}" for name in AREAS[area][1]]
    folders = [name for name in folders if (ROOT / name).exists()] or ["tests/test_any_number.py"]
    files = [
        file
        for name in folders
        for file in ([ROOT / name] if name.endswith(".py") else (ROOT / name).rglob("test_*.py"))
    ]
    package, _, name = module.rpartition(".")
    known = (f"from {module} import", f"from {package} import {name}")
    near = [
        file
        for file in files
        if file.stem == f"test_{path.stem}" or any(words in file.read_text(encoding="utf-8") for words in known)
    ]
    near.sort(key=lambda file: file.stem != f"test_{path.stem}")
    known_by = [str(path), *(str(file.relative_to(ROOT)) for file in near)]
    if near_only:
        return [known_by, folders]
    beyond = [f"tests/{name}" for name in AREAS[area][2] if f"tests/{name}" not in folders]
    left = ["tests", "src", *(f"--ignore={name}" for name in (*folders, *beyond))]
    return [run for run in (known_by, folders, beyond, left) if run]


def copy_of_all(folder: Path) -> None:
    """What git knows, and what it ignores but tests need."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
    for name in filter(None, listed.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name)
    for name in ("kernels/compiled", "report/assets/uplot"):
        shutil.copytree(ROOT / SOURCE / name, folder / SOURCE / name, dirs_exist_ok=True)


def passes(folder: Path, tests: list[str]) -> bool:
    """Whether tests pass in a copy; whatever they have started ends with them."""
    environment = os.environ | {"PYTHONPATH": str(folder / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    limited = ["sh", "-c", f'ulimit -t {MOST_WORK}; exec "$@"', "sh"]
    pytest_ends = ["-x", "-q", "-p", "no:cacheprovider", "-o", f"faulthandler_timeout={LONGEST_TEST}"]
    command = [*limited, sys.executable, "-m", "pytest", *pytest_ends, *tests]
    with (folder / "last.log").open("wb") as log:
        run = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log, start_new_session=True)
        try:
            return run.wait(LONGEST) in (0, pytest.ExitCode.NO_TESTS_COLLECTED)
        except subprocess.TimeoutExpired:
            return False
        finally:
            if run.poll() is None:
                os.killpg(run.pid, signal.SIGKILL)
                run.wait()


def tried(mutant: dict[str, Any], copies: SimpleQueue[Path], near_only: bool) -> dict[str, Any]:
    """A mutant with the run of tests that noticed it; empty where none did."""
    folder = copies.get()
    try:
        path = folder / mutant["path"]
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines(keepends=True)
        old = lines[mutant["line"] - 1].rstrip("\n")
        lines[mutant["line"] - 1] = mutant["new"] + "\n"
        path.write_text("".join(lines), encoding="utf-8")
        try:
            runs = tests_for(mutant["area"], Path(mutant["path"]), near_only)
            by = next((run for run in runs if not passes(folder, run)), [])
        finally:
            path.write_text(text, encoding="utf-8")
        return {**mutant, "old": old, "killed_by": by}
    finally:
        copies.put(folder)


def interval(killed: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's interval of a share."""
    share, spread = killed / count, z * z / count
    half = z * sqrt(share * (1 - share) / count + spread / (4 * count))
    return (share + spread / 2 - half) / (1 + spread), (share + spread / 2 + half) / (1 + spread)


def main() -> None:
    """Draw the mutants that the command line asks for, and say which the tests do not notice."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=60, help="mutants in all (60)")
    parser.add_argument("--seed", type=int, default=1, help="other lines (1)")
    parser.add_argument("--skip", type=int, default=0, help="go on behind so many of the sample (0)")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time (2)")
    parser.add_argument("--near-only", action="store_true", help="leave out the tests of other folders")
    parser.add_argument("--areas", nargs="+", choices=AREAS, default=list(AREAS))
    options = parser.parse_args()
    for name, line, _ in outdated(proved()):
        print(f"{EQUIVALENT.name}: {name} has no such line any more: {line}", file=sys.stderr)
    mutants = list(drawn(options.sample, options.seed, options.areas))
    random.Random(options.seed).shuffle(mutants)
    del mutants[: options.skip]
    OUT.mkdir(parents=True, exist_ok=True)
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(options.jobs):
        shutil.rmtree(OUT / str(number), ignore_errors=True)
        copy_of_all(OUT / str(number))
        copies.put(OUT / str(number))
    done: list[dict[str, Any]] = []
    with ThreadPoolExecutor(options.jobs) as pool, (OUT / "results.jsonl").open("a", encoding="utf-8") as results:
        for found in pool.map(lambda mutant: tried(mutant, copies, options.near_only), mutants):
            done.append(found)
            print(json.dumps(found), file=results, flush=True)
            if not found["killed_by"]:
                print(f"{found['path']}:{found['line']}\n- {found['old']}\n+ {found['new']}", flush=True)
    for area in [*options.areas, "all"]:
        of = [one for one in done if area in (one["area"], "all")]
        if of:
            killed = sum(bool(one["killed_by"]) for one in of)
            low, high = interval(killed, len(of))
            print(f"{area}: {killed} of {len(of)} killed, {killed / len(of):.0%} ({low:.0%} to {high:.0%})")


if __name__ == "__main__":
    main()
