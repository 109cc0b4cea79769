"""Examples of each command, as its help shows them."""

from __future__ import annotations

EXAMPLES = {
    "replant": (
        ("look, cut, fit and compare on a page", "replant open log.csv"),
        ("see what is in a log, and what to type next", "replant look log.csv"),
        ("fit two poles to all of it", "replant fit log.csv -i u -o y -p 2"),
        ("watch a simulated rig live, without hardware", "replant live demo --for 20s"),
    ),
    "open": (
        ("a log on a page", "replant open log.csv"),
        ("the session that was open last", "replant open"),
    ),
    "look": (
        ("columns, clock, likely input and output", "replant look log.csv"),
        ("the same with a plot of the columns", "replant look log.csv --out plots"),
        ("for scripts", "replant look log.csv -i u --json"),
    ),
    "run": (
        ("two poles, online", "replant run log.csv -i u -o y -p 2"),
        ("a zero, plots and a report", "replant run log.csv -i u -o y -p 2 --zeros 1 --out plots"),
        ("by the article's AMSGrad", "replant run log.csv -i u -o y -p 1 --optimizer amsgrad"),
    ),
    "fit": (
        ("two poles", "replant fit log.csv -i u -o y -p 2"),
        ("the number of poles chosen, and the dead time", "replant fit log.csv -i u -o y -p 1:3 --delay 0:0.2:0.1"),
        ("one model of two records", "replant fit log.csv log.csv -i u -o y -p 1"),
        ("the model kept", "replant fit log.csv -i u -o y -p 1 --save model.json"),
        ("for scripts", "replant fit log.csv -i u -o y -p 1 --json"),
    ),
    "compare": (
        ("a saved model over a log", "replant compare model.json log.csv"),
        ("the usual methods", "replant compare log.csv -i u -o y -p 1"),
        ("two of them", "replant compare log.csv -i u -o y -p 1 --optimizer srivc --optimizer least-squares"),
    ),
    "validate": (
        ("another log, with the columns that the model knows", "replant validate model.json log.csv"),
        ("a plot, and exit code 3 unless trusted", "replant validate model.json log.csv --out plots --require trusted"),
    ),
    "show": (("the model as people read it", "replant show model.json"), ("as JSON", "replant show model.json --json")),
    "fleet": (
        ("each file a rig, on every core", "replant fleet '*.csv' --by file -i u -o y -p 2 --out fleet"),
        (
            "each folder a rig, by the fit of whole records",
            "replant fleet . --by folder -i u -o y -p 2 --method fit --on processes:2 --out fleet",
        ),
    ),
    "examples": (("records of a motor, into this folder", "replant examples"),),
    "live": (
        ("a simulated rig, with a dashboard", "replant live demo --for 20s"),
        ("the same in the terminal, until it is trusted", "replant live demo --dashboard off --until trusted"),
    ),
    "demo": (("plots and a report", "replant demo --out plots"),),
    "reproduce": (
        ("one table", "replant reproduce table1"),
        ("for scripts", "replant reproduce table1 --json"),
    ),
}


def epilog_of(command: str) -> str:
    r"""Return the examples of a command as click's epilog, whose lines stay as they are."""
    lines = [line for what, typed in EXAMPLES[command] for line in (f"  # {what}", f"  {typed}")]
    return "\n".join(["\b", "Examples:", *lines])
