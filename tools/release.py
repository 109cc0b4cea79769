"""A release by one command: version, changelog, checks, wheels, a commit and a tag.  Nothing is uploaded.

    python tools/release.py 0.2.0     what `make release VERSION=0.2.0` does
    python tools/release.py --check   whether all files name the same version

It refuses a tree with changes, a version that is not above the present one, and an empty changelog.  A check that fails
leaves the files as they were, and makes neither commit nor tag.
"""

from __future__ import annotations

import datetime
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Where the version stands, and what stands around it.
VERSIONED = {
    "pyproject.toml": r'^(version = ")([^"]+)(")$',
    "src/replant/__init__.py": r'^(__version__ = ")([^"]+)(")$',
    "CITATION.cff": r"^(version: )(\S+)()$",
}
CHANGELOG, UNRELEASED = "CHANGELOG.md", "## Unreleased"
CHECKS = (
    ["make", "test"],
    ["make", "slow"],
    ["make", "wheels"],
    ["make", "wheels-test"],
    [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", "dist"],
)


class ReleaseError(Exception):
    """The release cannot be made; the message is for a person."""


def versions(root: Path) -> dict[str, str]:
    """Return the version that each file names."""
    return {name: _found(root, name)[2] for name in VERSIONED}


def _found(root: Path, name: str) -> re.Match[str]:
    found = re.search(VERSIONED[name], (root / name).read_text(encoding="utf-8"), re.MULTILINE)
    if found is None:
        raise ReleaseError(f"{name} names no version")
    return found


def present(root: Path) -> str:
    """Return the version that all files name."""
    named = versions(root)
    if len(set(named.values())) > 1:
        raise ReleaseError("versions differ: " + ", ".join(f"{name} has {version}" for name, version in named.items()))
    return next(iter(named.values()))


def numbers(version: str) -> tuple[int, ...]:
    """Return the three numbers of a version.

    Examples
    --------
    >>> numbers("0.10.2")
    (0, 10, 2)
    """
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        raise ReleaseError(f"{version!r} is no version: give three numbers, as VERSION=0.2.0")
    return tuple(map(int, version.split(".")))


def released(changelog: str, version: str, date: str) -> str:
    """Return the changelog with what is not released yet under the version, and an empty head above it."""
    head, mark, rest = changelog.partition(f"{UNRELEASED}\n")
    if not mark:
        raise ReleaseError(f"{CHANGELOG} has no line {UNRELEASED!r}")
    if not rest.partition("\n## ")[0].strip():
        raise ReleaseError(f"{CHANGELOG} tells nothing of this release: write it below {UNRELEASED!r}")
    return f"{head}{mark}\n## {version} ({date})\n{rest}"


def release(root: Path, version: str, checks: Sequence[Sequence[str]]) -> None:
    """Make a release: raise `ReleaseError` with the files as they were, or leave a commit and a tag."""
    if changed := _git(root, "status", "--porcelain"):
        raise ReleaseError(f"the tree has changes: commit or remove them first\n{changed}")
    if numbers(version) <= numbers(before := present(root)):
        raise ReleaseError(f"{version} is not above {before}")
    if _git(root, "tag", "--list", f"v{version}"):
        raise ReleaseError(f"there is a tag v{version} already")
    date = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    written = {CHANGELOG: released((root / CHANGELOG).read_text(encoding="utf-8"), version, date)}
    for name, pattern in VERSIONED.items():
        text = (root / name).read_text(encoding="utf-8")
        written[name] = re.sub(pattern, rf"\g<1>{version}\g<3>", text, count=1, flags=re.MULTILINE)
    try:
        for name, text in written.items():
            (root / name).write_text(text, encoding="utf-8")
        for command in checks:
            if subprocess.run(command, cwd=root, check=False).returncode:
                raise ReleaseError(f"{' '.join(command)} has failed: nothing is released")
    except BaseException:  # an interrupt as well
        _git(root, "checkout", "--", *written)
        raise
    _git(root, "commit", "--quiet", "--message", f"Release {version}", "--", *written)
    _git(root, "tag", "--annotate", f"v{version}", "--message", f"Release {version}")


def _git(root: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=root, check=True, capture_output=True, text=True).stdout.strip()


def main(arguments: Sequence[str]) -> str | None:
    """Return None, or what is wrong."""
    try:
        if arguments == ["--check"]:
            present(ROOT)
        elif len(arguments) == 1:
            release(ROOT, arguments[0], CHECKS)
            print(f"released {arguments[0]}: wheels and source in dist, commit and tag v{arguments[0]}; push them")
        else:
            raise ReleaseError("give the version: make release VERSION=0.2.0")
    except ReleaseError as error:
        return str(error)
    return None


if __name__ == "__main__":
    sys.exit(main([each for each in sys.argv[1:] if each]))
