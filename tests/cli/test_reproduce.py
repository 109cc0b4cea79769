"""``replant reproduce`` as a person and a script call it."""

import json

import pytest

from replant.cli import main


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


def test_json_is_one_object_and_nothing_else(capsys):
    main(["reproduce", "--json"])
    captured = capsys.readouterr()
    tables = json.loads(captured.out)
    assert captured.err == ""
    assert list(tables) == ["table1", "table2", "table3", "table4"]
    cell = tables["table3"]["adjusted"]["J_b1"]
    assert f"{cell['ours']:.2e}" == f"{cell['published']:.2e}" == "4.81e+06"
    buffered = tables["table1"]["Gradient, with buffer (batch 10)"]["J_a0"]
    assert abs(buffered["ours"] - buffered["published"]) <= 3 * buffered["std"]
    assert buffered["seeds"] == 20


def test_named_tables_run_alone_and_once(capsys):
    main(["reproduce", "table4", "table2", "table4", "--json"])
    assert list(json.loads(capsys.readouterr().out)) == ["table4", "table2"]


def test_a_person_reads_tables_and_a_summary(capsys):
    main(["reproduce", "table2"])
    out = capsys.readouterr().out
    assert "Table 2" in out
    assert "Table 1:" not in out
    assert "12 of 12 figures and 6 of 6 sums equal in all printed digits." in out


def test_out_writes_both_files(capsys, tmp_path):
    out = tmp_path / "deep" / "folder"
    main(["reproduce", "table2", "--json", "--out", str(out)])
    assert json.loads((out / "tables.json").read_text()) == json.loads(capsys.readouterr().out)
    assert "| AMSGrad, amplitude 10 | J_a0 | 4.05e+03 | 4.05e+03 | equal |" in (out / "tables.md").read_text()


def test_an_unknown_name_lists_the_names(capsys):
    line = fails(capsys, "table1", "tabel2")
    assert "'tabel2'" in line
    assert "table1, table2, table3, table4" in line


def test_a_file_where_the_folder_should_be_is_named(capsys, tmp_path):
    file = tmp_path / "out"
    file.write_text("")
    assert str(file) in fails(capsys, "table2", "--out", str(file))


def test_a_page_that_cannot_be_written_is_named(capsys, tmp_path):
    (tmp_path / "tables.md").mkdir()
    assert "tables.md" in fails(capsys, "table2", "--out", str(tmp_path))
