"""``replant reproduce`` as a person and a script call it."""

import json
import sys
from functools import cache

import pytest

from replant.cli import main
from replant.paper import actuator, figures, tables
from replant.paper.figures import NAMES
from support.cases import every

REPRODUCE = actuator.reproduce_actuator
PNG = b"\x89PNG\r\n\x1a\n"


@cache
def short_run():
    """The actuator's experiment on 0.8 s: three tests draw what it gives."""
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch)
        return REPRODUCE()


@cache
def table(wanted):
    """A table of the article: the tests that show it share its runs."""
    return tables.reproduce(wanted)


def shorten(patch):
    whole = actuator.measure_rig
    patch.setattr(actuator, "measure_rig", lambda samples=0, seed=0: whole(800, seed))


@pytest.fixture
def short(monkeypatch):
    """Let the actuator's record be 0.8 s long."""
    shorten(monkeypatch)


@pytest.fixture
def run_before(monkeypatch):
    """Have each experiment run once, the actuator's on a short record."""
    monkeypatch.setattr(actuator, "reproduce_actuator", lambda on_run: short_run())
    monkeypatch.setattr(figures, "reproduce", lambda wanted, **_: table(wanted))


def fails(capsys, *arguments):
    """Run a command that must fail; return its one line on stderr."""
    with pytest.raises(SystemExit) as stop:
        main(["reproduce", *arguments])
    assert stop.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("replant: ")
    assert captured.err.count("\n") == 1
    return captured.err


def assert_pictures(folder, *names):
    """Check that these pictures, and no others, are in the folder, as PNG and SVG that can be opened."""
    for name in names:
        assert (folder / f"{name}.png").read_bytes().startswith(PNG)
        svg = (folder / f"{name}.svg").read_text(encoding="utf-8")
        assert svg.startswith("<?xml")
        assert svg.rstrip().endswith("</svg>")
    assert {path.name for path in folder.iterdir() if path.suffix not in (".json", ".md", ".html")} == {
        f"{name}.{kind}" for name in names for kind in ("png", "svg")
    }


@pytest.mark.slow
def test_json_of_the_tables_is_one_object_and_nothing_else(capsys, run_before):
    main(["reproduce", "table1", "table2", "table3", "table4", "--json"])
    captured = capsys.readouterr()
    tables = json.loads(captured.out)
    assert captured.err == ""
    assert list(tables) == ["table1", "table2", "table3", "table4"]
    cell = tables["table3"]["adjusted"]["J_b1"]
    assert f"{cell['ours']:.2e}" == f"{cell['published']:.2e}" == "4.81e+06"
    buffered = tables["table1"]["Gradient, with buffer (batch 10)"]["J_a0"]
    assert abs(buffered["ours"] - buffered["published"]) <= 3 * buffered["std"]
    assert buffered["seeds"] == 20


@pytest.mark.slow
def test_without_names_everything_is_reproduced(capsys, tmp_path, monkeypatch, run_before):
    monkeypatch.chdir(tmp_path)
    main(["reproduce", "--json"])
    captured = capsys.readouterr()
    assert captured.err == ""
    tables = json.loads(captured.out)
    assert list(tables) == ["table1", "table2", "table3", "table4", "actuator"]
    out = tmp_path / "out" / "reproduce"
    assert json.loads((out / "tables.json").read_text()) == tables
    assert_pictures(out, "fig1", "fig2", "fig3", "fig4", "fig6", "fig7", "fig7-exact", "fig8", "fig8-exact")
    page = (out / "tables.md").read_text()
    assert page.count("\n## ") == 4 + 1 + 1  # the tables, their summary, the actuator
    report = (out / "report.html").read_text(encoding="utf-8")
    assert report.count('<figure class="sheet">') == 9
    assert len(report) < 3_000_000


def test_named_tables_run_alone_and_once(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["reproduce", "table4", "table2", "table4", "--json"])
    assert list(json.loads(capsys.readouterr().out)) == ["table4", "table2"]
    assert list(tmp_path.iterdir()) == []


def test_a_person_reads_tables_and_a_summary(capsys):
    main(["reproduce", "table2"])
    out = capsys.readouterr().out
    assert "Table 2" in out
    assert "Table 1:" not in out
    assert "12 of 12 figures and 6 of 6 sums equal in all printed digits." in out


def test_a_person_reads_the_actuators_table(capsys, tmp_path, monkeypatch, short):
    monkeypatch.chdir(tmp_path)
    main(["reproduce", "actuator"])
    out = capsys.readouterr().out
    assert "The actuator: twelve online runs" in out
    assert "very small gain" in out
    assert "Figures" not in out
    assert list(tmp_path.iterdir()) == []


def test_figures_are_written_where_one_says(capsys, tmp_path):
    out = tmp_path / "pictures"
    main(["reproduce", "fig4", "--out", str(out)])
    assert_pictures(out, "fig4")
    assert capsys.readouterr().out == f"wrote {out / 'fig4.png'} and .svg\n"


def test_figure_6_needs_no_online_run(capsys, tmp_path, monkeypatch, short):
    monkeypatch.setattr(actuator, "reproduce_actuator", None)
    main(["reproduce", "fig6", "--out", str(tmp_path)])
    assert_pictures(tmp_path, "fig6")


@pytest.mark.slow  # the same pictures as of everything
def test_figures_7_and_8_bring_the_table_and_both_filters(capsys, tmp_path, run_before):
    main(["reproduce", "fig8", "--out", str(tmp_path)])
    assert "The actuator: twelve online runs" in capsys.readouterr().out
    assert_pictures(tmp_path, "fig8", "fig8-exact")
    assert list(json.loads((tmp_path / "tables.json").read_text())) == ["actuator"]


@pytest.mark.slow  # the same pictures as above, under another command
def test_the_demo_in_full_is_the_actuator_experiment(capsys, tmp_path, run_before):
    main(["demo", "--full", "--out", str(tmp_path)])
    assert "The actuator: twelve online runs" in capsys.readouterr().out
    assert_pictures(tmp_path, "fig6", "fig7", "fig7-exact", "fig8", "fig8-exact")


def test_out_writes_both_files(capsys, tmp_path):
    out = tmp_path / "deep" / "folder"
    main(["reproduce", "table2", "--json", "--out", str(out)])
    assert json.loads((out / "tables.json").read_text()) == json.loads(capsys.readouterr().out)
    assert "| AMSGrad, amplitude 10 | J_a0 | 4.05e+03 | 4.05e+03 | equal |" in (out / "tables.md").read_text()


@every("unknown", ["tabel2", "fig5", "FIG1", "report"])
def test_an_unknown_name_lists_the_names(capsys, unknown):
    line = fails(capsys, "table1", unknown)
    assert f"'{unknown}'" in line
    assert ", ".join(NAMES) in line


def test_a_file_where_the_folder_should_be_is_named(capsys, tmp_path):
    file = tmp_path / "out"
    file.write_text("")
    assert str(file) in fails(capsys, "table2", "--out", str(file))


@pytest.mark.parametrize(("name", "path"), [("table2", "tables.md"), ("fig4", "fig4.svg")])
def test_a_page_that_cannot_be_written_is_named(capsys, tmp_path, name, path):
    (tmp_path / path).mkdir()
    assert path in fails(capsys, name, "--out", str(tmp_path))


def test_without_matplotlib_figures_say_what_to_install_and_tables_run(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert "pip install 'replant[report]'" in fails(capsys, "fig1", "--out", str(tmp_path))
    main(["reproduce", "table2", "--json"])
    assert list(json.loads(capsys.readouterr().out)) == ["table2"]
