"""The page docs/performance.md: the figures of one run as tables.

What bounds them.  Estimated by hand for one update of AMSGrad with five parameters:

* Dependent operations. The next update needs the parameters of this one, so that latencies add up: the
  prediction (one product, then five sums in their order: about 24 cycles), the error and its weight (8), the gradient
  (4), its square into v (12), the maximum (4), the square root (19), the sum and the division (17), the new parameter
  (4): about 90 cycles. This is the limit that the kernels reach. The operations themselves (14 multiplications and sums
  an entry, a square root and a division for four entries at a time) would take about 30 cycles.
* One update a sample. Without replay a sample takes about 450 instructions (650 with Adam). A processor reorders
  about three hundred, so that samples hardly overlap, and the latency from the input through filters, regressor and row
  of the buffer to the parameters counts. A number that is stored and loaded again on this path costs nine cycles more,
  a number that is stored alone and loaded as part of a vector twenty-seven.
* Memory. A row is P + 2 numbers, 56 bytes, one or two cache lines: regressor, output and 1/m^2 lie side by side.
  The rows that a sample draws are known before the first of them is learned, so that the processor loads them while the
  chain above runs. A buffer in the second-level cache costs nothing; one in main memory costs the latency of memory
  over the number of loads in flight.
* One call from Python. Most of its time is that of the interpreter and of passing arguments; the kernel is a small
  part. `update_many` has this cost once for a group of samples.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from typing import Any

Figures = dict[str, Any]

BUFFERS = {"none": "no replay", "one seed": "replay, one seed", "own seeds": "replay, own seeds"}
HEAD = """# Performance

*How fast is replant, and beside what?*

This page is written by `make bench` from one run; do not edit it. Times depend on the machine; the ratios can be
compared. Both sides of a ratio are measured alternately in the same run; it is a median over many repetitions, with the
quartiles in brackets.

"""
EVERY_ROW = "Every row: {{download}}`{0}.csv <performance/{0}.csv>`."
#: Members whose rows the page shows; the table has all.
SHOWN_MEMBERS = (64,)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; all columns but the first are numbers."""
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def between(rows: Sequence[Figures], key: str, form: str) -> str:
    """Return the least and the greatest of a figure."""
    values = [row[key] for row in rows]
    return f"{min(values):{form}}" if len(rows) == 1 else f"{min(values):{form}} to {max(values):{form}}"


def ratio(row: Figures) -> str:
    low, high = row["ratio_quartiles"]
    return f"{row['ratio']:.2f} ({low:.2f}..{high:.2f})"


def kernels(figures: Figures) -> str:
    """One line an optimizer, over all numbers of parameters."""
    lines = []
    for optimizer in dict.fromkeys(row["optimizer"] for row in figures["rows"]):
        mine = [row for row in figures["rows"] if row["optimizer"] == optimizer]
        alone, replayed = ([row for row in mine if bool(row["replay"]) == replay] for replay in (False, True))
        lines.append(
            [
                optimizer, between(alone, "sample", ".0f"), between(alone, "ratio", ".2f"),
                between(replayed, "update", ".1f"), between(replayed, "ratio", ".2f"),
            ]
        )  # fmt: skip
    worst = max(figures["rows"], key=lambda row: row["ratio"])
    entries = [row["entries"] for row in figures["rows"]]
    text = (
        "Time of one sample through filters, regressor, buffer and update, compared with a C program of the same "
        "arithmetic (`benchmarks/reference.c`, gcc -O3 -march=native) that begins at the same state and ends at the "
        "same numbers; with replay there are 20 updates a sample. Times are in nanoseconds, from the least to the "
        f"greatest of {min(entries)} to {max(entries)} parameters.\n\n"
    )
    head = ["optimizer", "a sample", "beside C", "with replay: an update", "beside C"]
    largest = f"\nLargest ratio {worst['ratio']:.2f} ({worst['optimizer']}, P = {worst['entries']}). {EVERY_ROW}\n"
    return text + table(head, lines) + largest.format("kernels")


def parts(figures: Figures) -> str:
    """One line a part, over all numbers of parameters."""
    lines = []
    for part in sorted({row["part"] for row in figures["rows"]}):
        mine = [row for row in figures["rows"] if row["part"] == part]
        entries = [row["entries"] for row in mine]
        size = f"{min(entries)} to {max(entries)}" if len(mine) > 1 else str(entries[0])
        lines.append([part, size, between(mine, "sample", ".0f"), between(mine, "ratio", ".2f")])
    text = (
        "The parts of the default method (regressor and instruments from the refined filter, recursive least squares "
        "on the factors U D U') and the Kalman filter, compared with `benchmarks/parts.c`. Times are in nanoseconds "
        "a sample. One kernel serves every structure, clock and dead time.\n\n"
    )
    return text + table(["part", "P", "a sample", "beside C"], lines) + f"\n{EVERY_ROW}\n".format("parts")


def default(figures: Figures) -> str:
    rows = [[row["case"], f"{row['ns']:.0f}", row["beside"], ratio(row)] for row in figures["rows"]]
    text = (
        "One sample in `update_many`, three poles and a zero, in nanoseconds, and its ratio to the same without. "
        f"Without a noise model a sample takes {figures['plain']:.0f} ns.\n\n"
    )
    return text + table(["settings", "ns", "beside", "ratio"], rows)


def latency(figures: Figures) -> str:
    rows = [
        [
            row["case"], f"{row['calls']:,}", f"{row['median']:.2f}", f"{row['percentile_999']:.1f}",
            f"{row['maximum']:.0f}", f"{row['kernel']:.2f}",
        ]
        for row in figures["rows"]
    ]  # fmt: skip
    text = "`Identifier.update(u, y)`, one call a sample, three poles and a zero. Microseconds.\n\n"
    head = ["settings", "calls", "median", "99.9 %", "longest", "a sample in `update_many`"]
    grown = f"\nMemory grew by {figures['growth']:,} bytes over a hundred thousand calls.\n"
    judged = figures["verdict"]
    verdict = (
        f"\nA verdict on the 10,000 samples kept takes {judged['milliseconds']:.0f} ms, "
        f"{judged['ratio']:.1f} times as long as learning them.\n"
    )
    return text + table(head, rows) + grown + verdict


def due(figures: Figures) -> str:
    rows = [
        [
            row["case"], f"{row['calls']:,}", f"{row['median']:.1f}", f"{row['percentile_999']:.0f}",
            f"{row['longest']:.0f}", str(row["beyond"]), str(row.get("forced_waits", "")),
        ]
        for row in figures["rows"]
    ]  # fmt: skip
    text = (
        f"A loop that takes a sample each millisecond for {figures['seconds']:.0f} s, two poles, while the plant "
        "changes three times: how long after a sample was due `Identifier.update` had returned, in microseconds. The "
        "loop asks the clock until the next sample is due; what the loop that does nothing loses is the machine's.\n\n"
    )
    head = ["loop", "samples", "median", "99.9 %", "longest", f"beyond {figures['limit']:.0f} µs", "forced waits"]
    return text + table(head, rows)


def peers(figures: Figures) -> str:
    rows = [
        [
            row["task"], row["library"], row["form"], f"{row['ours'] / 1e3:.2f}", f"{row['theirs'] / 1e3:.2f}",
            ratio(row), f"{row['difference']:.0e}",
        ]
        for row in figures["rows"]
    ]  # fmt: skip
    text = (
        "Five parameters, the same samples, the same estimate at the end (last column: the relative difference). Ours "
        "filters (u, y) itself. The others get their regressors from the same filter, one product of a NumPy matrix "
        'and vector a sample ("from u, y"), or ready made ("regressor given"). torch is given the gradient; optax is '
        "jitted, once a sample, or over whole chunks against `update_many`. Microseconds a sample.\n\n"
    )
    return text + table(["task", "library", "form", "ours", "theirs", "ratio", "difference"], rows)


def ensembles(figures: Figures) -> str:
    def cells(row: Figures) -> list[str]:
        name = f"{row['optimizer']}, {BUFFERS[row['buffer']]}"
        return [name, str(row["members"]), f"{row['updates_per_second'] / 1e6:.1f}", quartiles(row)]

    def quartiles(row: Figures) -> str:
        low, high = row["quartiles"]
        return f"{row['ratio']:.2f} ({low:.2f}..{high:.2f})"

    text = (
        "`Ensemble` steps sixteen members in the lanes of SIMD vectors. The table has the updates/s of all "
        "members together on one thread, and their ratio to one identifier in the same run, with chunks of the same "
        "length. Longer chunks, more members, separate buffers, and other programs that use the last-level cache "
        "reduce the ratio.\n\n"
    )
    shown = [row for row in figures["one_thread"] if row["members"] in SHOWN_MEMBERS]
    alone = table(["", "members", "10^6 updates/s", "ratio"], map(cells, shown))
    alone += f"\n{EVERY_ROW}\n".format("ensembles")
    several = [
        [*cells(row)[:2], str(row["threads"]), *cells(row)[2:], f"{row['efficiency']:.2f}"]
        for row in figures["threads"]
    ]
    head = ["", "members", "threads", "10^6 updates/s", "ratio to one thread", "efficiency"]
    explained = (
        '\nOn several threads, by wall-clock time, which needs an idle machine. "efficiency" is the processor time on '
        "one thread over that on several.\n\n"
    )
    found = figures["default"]
    default = (
        f"\n{found['members']} members of the default method, on one thread: {found['between_reviews']:.1f} times the "
        f"samples of one identifier between two reviews of the record, {found['with_reviews']:.1f} times with these, "
        f"which every member makes by itself. Two threads take {found['two_threads']:.2f} times as many as one with "
        f"these and {found['two_threads_between']:.2f} times between them, two processes that have nothing in common "
        f"{found['two_processes']:.2f} times; "
        f"efficiency {found['efficiency']:.2f}.\n"
    )
    return text + alone + explained + table(head, several) + default


def streaming(figures: Figures) -> str:
    names = [name for name in ("memory", "parquet", "csv") if name in figures]

    def cell(name: str, key: str, form: str, unit: float = 1.0) -> str:
        found = figures[name].get(key)
        return format(found["median"] / unit, form) if found else ""

    labels = {"memory": "rows in memory", "parquet": "Parquet", "csv": "CSV"}
    rows = [
        [
            labels[name],
            cell(name, "seconds", ".1f"),
            cell(name, "samples_per_second", ".2f", 1e6),
            cell(name, "ratio", ".2f"),
            cell(name, "processor_ratio", ".2f"),
            cell(name, "resident_mb", ".0f"),
        ]
        for name in names
    ]
    text = f"{figures['rows']:,} rows of time, input and output through the default method (`replant run`).\n\n"
    return text + table(["from", "s", "10^6 samples/s", "ratio to memory", "of processor time", "resident MB"], rows)


def scaling(figures: Figures) -> str:
    rows = [
        [
            f"{row['what']}, {row['size']}",
            ", ".join(str(size) for size in row["sizes"]),
            ", ".join(f"{cost:.0f}" for cost in row["nanoseconds"]),
            f"{row['exponent']:.2f}",
            f"{row['expected']:g}",
        ]
        for row in figures["rows"]
    ]
    text = (
        "The exponent is the slope of cost over size in logarithmic scales, for sizes at which the arithmetic "
        "outweighs the cost of a call. In the picture points are measured, and dashed lines have the expected "
        "slope.\n\n"
        "![Cost over the number of parameters, the batch and the buffer](pictures/scaling.svg)\n\n"
    )
    return text + table(["kernel", "sizes", "ns", "exponent", "expected"], rows)


def starting(figures: Figures) -> str:
    rows = [[row["case"], f"{row['milliseconds']:.0f}", ratio(row)] for row in figures["rows"]]
    text = (
        'Fresh interpreters, in turn, their processor time beside that of `python -c "import numpy"`. '
        "`import replant` loads what it offers when the first public name is used; `--help` loads none of it.\n\n"
    )
    yardstick = ['`python -c "import numpy"`', f"{figures['numpy']:.0f}", "1"]
    return text + table(["command", "ms", "ratio"], [yardstick, *rows])


def tables(figures: Figures) -> dict[str, list[Figures]]:
    """Return every row of the sections of which the page shows some, for CSV."""
    return {
        "kernels": figures["kernels"]["rows"],
        "parts": figures["parts"]["rows"],
        "ensembles": figures["ensembles"]["one_thread"],
    }


def as_csv(rows: Sequence[Figures]) -> str:
    """Return rows as CSV; quartiles as two columns."""
    lines = []
    for row in rows:
        flat: Figures = {}
        for key, value in row.items():
            flat |= (
                {f"{key}_{end}": each for end, each in zip(("low", "high"), value, strict=True)}
                if "quartiles" in key
                else {key: value}
            )
        lines.append(flat)
    out = io.StringIO()
    writer = csv.DictWriter(out, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return out.getvalue()


SECTIONS: dict[str, tuple[str, Callable[[Figures], str]]] = {
    "kernels": ("Kernels beside C", kernels),
    "parts": ("Parts of the default method beside C", parts),
    "default": ("Noise model and reference", default),
    "latency": ("One sample from Python", latency),
    "due": ("A loop at 1 kHz", due),
    "peers": ("Other libraries", peers),
    "ensembles": ("Many identifiers at once", ensembles),
    "streaming": ("Logs larger than memory", streaming),
    "scaling": ("How cost grows", scaling),
    "starting": ("Starting", starting),
}


def section(name: str, figures: Figures) -> str:
    """Return one section of the page."""
    title, body = SECTIONS[name]
    return f"## {title}\n\n{body(figures)}"


def page(figures: Figures) -> str:
    """Return the whole page."""
    machine = "\n".join(f"* {key}: {value}" for key, value in figures["machine"].items())
    return HEAD + machine + "\n\n" + "\n".join(section(name, figures[name]) for name in SECTIONS) + "\n"
