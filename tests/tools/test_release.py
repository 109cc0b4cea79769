"""A release writes version and changelog, commits and tags; what is refused leaves everything as it was."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import release

PASSES, FAILS = [sys.executable, "-c", ""], [sys.executable, "-c", "raise SystemExit(1)"]
FILES = {
    "pyproject.toml": '[project]\nversion = "0.1.0"\n',
    "src/replant/__init__.py": '__version__ = "0.1.0"\n',
    "CITATION.cff": "cff-version: 1.2.0\nversion: 0.1.0\n",
    "CHANGELOG.md": "# Changelog\n\n## Unreleased\n\n- Something.\n",
}


def git(root: Path, *arguments: str) -> str:
    command = ["git", "-c", "user.name=A", "-c", "user.email=a@b.c", *arguments]
    return subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for part in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{part}_NAME", "A")
        monkeypatch.setenv(f"GIT_{part}_EMAIL", "a@b.c")
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "--message", "Begin")
    return tmp_path


def content(root: Path) -> dict[str, str]:
    return {name: (root / name).read_text(encoding="utf-8") for name in FILES}


def test_a_release_names_its_version_everywhere_and_leaves_a_commit_and_a_tag(clone: Path) -> None:
    seen = clone / "seen"
    note = f"import pathlib; pathlib.Path({str(seen)!r}).write_text(pathlib.Path('pyproject.toml').read_text())"
    release.release(clone, "0.2.0", [[sys.executable, "-c", note]])
    assert '"0.2.0"' in seen.read_text(encoding="utf-8")  # what is checked is what is released
    assert set(release.versions(clone).values()) == {"0.2.0"}
    changelog = (clone / "CHANGELOG.md").read_text(encoding="utf-8")
    assert changelog.index("## Unreleased") < changelog.index("## 0.2.0 (") < changelog.index("- Something.")
    assert "cff-version: 1.2.0" in (clone / "CITATION.cff").read_text(encoding="utf-8")
    assert git(clone, "tag").split() == ["v0.2.0"]
    assert git(clone, "log", "-1", "--format=%s").strip() == "Release 0.2.0"
    assert git(clone, "status", "--porcelain").split() == ["??", "seen"]


@pytest.mark.parametrize(
    ("version", "words"),
    [("0.1.0", "not above 0.1.0"), ("0.0.9", "not above"), ("0.2", "three numbers"), ("v0.2.0", "three numbers")],
)
def test_a_version_that_is_none_or_not_above_the_present_one_is_refused(clone: Path, version: str, words: str) -> None:
    with pytest.raises(release.ReleaseError, match=words):
        release.release(clone, version, [PASSES])
    assert content(clone) == FILES


def test_a_tree_with_changes_is_refused(clone: Path) -> None:
    (clone / "new.py").write_text("", encoding="utf-8")
    with pytest.raises(release.ReleaseError, match=r"new\.py"):
        release.release(clone, "0.2.0", [PASSES])
    assert content(clone) == FILES


def test_a_check_that_fails_leaves_the_files_as_they_were(clone: Path) -> None:
    with pytest.raises(release.ReleaseError, match="has failed"):
        release.release(clone, "0.2.0", [PASSES, FAILS])
    assert content(clone) == FILES
    assert git(clone, "tag") == ""
    assert git(clone, "status", "--porcelain") == ""


@pytest.mark.parametrize("text", ["# Changelog\n", "# Changelog\n\n## Unreleased\n\n## 0.1.0\n\n- Old.\n"])
def test_a_release_that_the_changelog_does_not_tell_of_is_refused(text: str) -> None:
    with pytest.raises(release.ReleaseError, match=r"CHANGELOG\.md"):
        release.released(text, "0.2.0", "2026-01-01")


def test_versions_that_differ_are_named(clone: Path) -> None:
    (clone / "CITATION.cff").write_text("version: 0.0.1\n", encoding="utf-8")
    with pytest.raises(release.ReleaseError, match=r"CITATION\.cff has 0\.0\.1"):
        release.present(clone)
