"""What is shipped: source distribution, wheel, uPlot in them, and under which licences the rest is."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import re
import tarfile
import tomllib
import zipfile
from email import message_from_string
from importlib import metadata
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement

from support.cases import every

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]
UPLOT = {"package/dist/uPlot.iife.min.js": b"script", "package/dist/uPlot.min.css": b"style", "package/LICENSE": b"MIT"}

# --- what is in it


@pytest.fixture(autouse=True)
def no_hooks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have nothing fetched."""
    monkeypatch.setenv("HATCH_BUILD_NO_HOOKS", "true")


def test_everything_that_the_source_distribution_lists_exists() -> None:
    listed = PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert [name for name in listed if not (ROOT / name.lstrip("/")).exists()] == []


def test_the_source_distribution_has_what_make_and_pip_need(tmp_path: Path) -> None:
    (built,) = SdistBuilder(str(ROOT)).build(directory=str(tmp_path))
    with tarfile.open(built) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    needed = {"Makefile", "constraints.txt", "hatch_build.py", "pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md"}
    needed |= {"src/replant/__init__.py", "tests/conftest.py", "benchmarks/__main__.py", "docs/performance.md"}
    assert needed <= names
    assert not [name for name in names if name.startswith((".git", ".venv", "out/")) and name != ".gitignore"]


def test_the_wheel_has_the_package_and_its_assets(tmp_path: Path) -> None:
    (built,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(built) as archive:
        names = set(archive.namelist())
    assets = "replant/report/assets"
    assert {"replant/py.typed", f"{assets}/report.js", "replant/live/dashboard/assets/index.html"} <= names
    fetched = (ROOT / "src" / assets / "uplot").is_dir()
    assert {f"{assets}/uplot/{Path(name).name}" for name in UPLOT} & names == (
        {f"{assets}/uplot/{Path(name).name}" for name in UPLOT} if fetched else set()
    )
    assert {name.partition("/")[0] for name in names if ".dist-info" not in name} == {"replant"}


# --- uPlot


@pytest.fixture
def hook(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The build hook, which takes `UPLOT` for uPlot's files."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    known = {name: hashlib.sha256(content).hexdigest() for name, content in UPLOT.items()}
    assert known.keys() == module.FILES.keys()
    monkeypatch.setattr(module, "FILES", known)
    return module


def npm_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Put a program in place of npm."""
    (tmp_path / "npm").write_text(f"#!/bin/sh\n{script}\n")
    (tmp_path / "npm").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")


def npm_that_packs(files: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with tarfile.open(tmp_path / "packed", "w:gz") as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    npm_that(tmp_path, monkeypatch, f'for last; do :; done\ncp "{tmp_path}/packed" "$last/uplot-1.6.32.tgz"')


def test_uplot_is_fetched_once(hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    npm_that_packs({**UPLOT, "package/more.js": b"not wanted"}, tmp_path, monkeypatch)
    for _ in range(2):
        hook.provide(tmp_path / "uplot")
        npm_that(tmp_path, monkeypatch, "exit 1")  # the second time it is there
    found = {path.name: path.read_bytes() for path in (tmp_path / "uplot").iterdir()}
    assert found == {Path(name).name: content for name, content in UPLOT.items()}


@every("name", UPLOT)
@every("how", ["changed", "missing"])
def test_what_is_not_uplot_is_refused(
    hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, how: str
) -> None:
    files = {key: content + b"!" * (key == name) for key, content in UPLOT.items() if (how, key) != ("missing", name)}
    npm_that_packs(files, tmp_path, monkeypatch)
    with pytest.raises(ValueError, match=f"{name} of the npm package uplot@1.6.32 is not the file that it should be"):
        hook.provide(tmp_path / "uplot")
    assert not (tmp_path / "uplot").exists()


def test_without_npm_or_network_the_build_says_so_and_goes_on(
    hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    app = SimpleNamespace(display_warning=said.append)
    builder = hook.UPlotHook(str(tmp_path), {}, None, None, str(tmp_path), "wheel", app)
    monkeypatch.setenv("PATH", str(tmp_path))
    builder.initialize("standard", {})
    npm_that(tmp_path, monkeypatch, "echo no network >&2; exit 1")
    builder.initialize("standard", {})
    assert said == [
        f"uPlot is left out: {reason}. The report and the dashboard need it."
        for reason in ("there is no npm", "`npm pack uplot@1.6.32` failed: no network")
    ]


# --- the native library


def test_a_compiler_is_asked_for_where_there_is_none(
    hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(target: str) -> list[str]:
        own: list[str] = hook.PackageHook(str(ROOT), {}, None, None, str(tmp_path), target, None).dependencies()
        return own

    assert hook.get_build_hook() is hook.PackageHook
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("REPLANT_WHEEL", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert (asked("wheel"), asked("sdist")) == (["ziglang>=0.13"], [])
    monkeypatch.setenv("CC", "some-cc")
    assert asked("wheel") == []
    monkeypatch.setenv("REPLANT_WHEEL", "aarch64-linux-gnu:manylinux_2_17_aarch64")
    assert asked("wheel") == ["ziglang>=0.13"]


@pytest.mark.slow
def test_the_wheel_of_this_system_has_its_library(
    hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("REPLANT_WHEEL", raising=False)
    monkeypatch.setattr(hook, "provide", lambda folder: None)
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import wheels

    build_data: dict[str, Any] = {"force_include": {}}
    builder = hook.PackageHook(str(ROOT), {}, None, None, str(tmp_path), "wheel", SimpleNamespace())
    builder.initialize("standard", build_data)
    assert build_data["pure_python"] is False
    assert re.fullmatch(r"py3-none-\w+", build_data["tag"])
    ((library, place),) = build_data["force_include"].items()
    with zipfile.ZipFile(tmp_path / "good.whl", "w") as archive:
        archive.write(library, place)
    builder.finalize("standard", build_data, "")
    assert not Path(library).exists()
    wheels.check(tmp_path / "good.whl")
    with zipfile.ZipFile(tmp_path / "bad.whl", "w") as archive:
        archive.writestr("replant/__init__.py", "")
    with pytest.raises(SystemExit, match=r"bad\.whl has no library"):
        wheels.check(tmp_path / "bad.whl")


def test_a_wheel_of_another_processor_is_not_tried_without_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import foreign

    monkeypatch.setenv("PATH", str(tmp_path))
    arguments = tmp_path / "replant.whl", "aarch64", "", tmp_path, ROOT / "constraints.txt"
    with pytest.raises(foreign.UntriedError, match=r"no qemu-aarch64-static or .*: apt install qemu-user-static"):
        foreign.try_out(*arguments)
    (tmp_path / "qemu-aarch64").write_text("")
    (tmp_path / "qemu-aarch64").chmod(0o755)
    with pytest.raises(foreign.UntriedError, match="no apt-get: its Python comes from Debian"):
        foreign.try_out(*arguments)
    (tmp_path / "apt-get").write_text("#!/bin/sh\necho no network >&2\nexit 100\n")
    (tmp_path / "apt-get").chmod(0o755)
    with pytest.raises(foreign.UntriedError, match="apt-get update for arm64 fails: no network"):
        foreign.try_out(*arguments)


@pytest.mark.parametrize(
    ("python", "machine", "tag"),
    [
        ("macosx-10.9-universal2", "arm64", "py3-none-macosx_11_0_arm64"),
        ("macosx-10.9-universal2", "x86_64", "py3-none-macosx_10_9_x86_64"),
        ("linux-x86_64", "x86_64", "py3-none-linux_x86_64"),
    ],
)
def test_the_wheel_is_for_the_processor_of_its_library(
    hook: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, python: str, machine: str, tag: str
) -> None:
    monkeypatch.delenv("REPLANT_WHEEL", raising=False)
    monkeypatch.setattr(hook, "provide", lambda folder: None)
    monkeypatch.setattr(hook.sysconfig, "get_platform", lambda: python)
    monkeypatch.setattr(hook.platform, "machine", lambda: machine)
    monkeypatch.setattr(hook.subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=0))
    build_data: dict[str, Any] = {"force_include": {}}
    hook.PackageHook(str(ROOT), {}, None, None, str(tmp_path), "wheel", SimpleNamespace()).initialize(
        "editable", build_data
    )
    assert build_data["tag"] == tag


# --- licences

#: Permissive ones, and copyleft that ends at its own files (MPL), as SPDX calls them.
ALLOWED = {
    "0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "CC0-1.0", "ISC",
    "MIT", "MIT-CMU", "MPL-2.0", "PSF-2.0", "Zlib",
}  # fmt: skip
#: The classifiers, and words in the field that was there before SPDX, that stand for such a one.
CLASSIFIERS = {
    "License :: OSI Approved :: Apache Software License": "Apache-2.0",
    "License :: OSI Approved :: BSD License": "BSD-3-Clause",
    "License :: OSI Approved :: ISC License (ISCL)": "ISC",
    "License :: OSI Approved :: MIT License": "MIT",
    "License :: OSI Approved :: Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "License :: OSI Approved :: Python Software Foundation License": "PSF-2.0",
}
WORDS = {"Apache 2.0": "Apache-2.0", "BSD": "BSD-3-Clause"}
#: What a classifier names beside the licences of the files that are installed, and the files that it is for.
#: docutils is public domain and BSD but for a mode for Emacs, which is in its source distribution alone.
NOT_INSTALLED = {"docutils": {"License :: OSI Approved :: GNU General Public License (GPL)": ".el"}}
CLASSIFIERS["License :: Public Domain"] = "CC0-1.0"


def licence_of(about: metadata.PackageMetadata) -> str:
    """Return the SPDX expression of a distribution, made of what it has; empty where it says nothing that is known."""
    if "License-Expression" in about:
        return about["License-Expression"]
    classified = [one for one in about.get_all("Classifier") or [] if one.startswith("License :: ")]
    if classified:
        return " AND ".join(CLASSIFIERS.get(one, one) for one in classified)
    written = (about["License"] or "").strip() if "License" in about else ""
    return WORDS.get(written, written)


def licences_of_files(name: str, distribution: metadata.Distribution) -> list[str]:
    """Return the licences of a distribution, those of files left out that are not installed."""
    licences = licence_of(distribution.metadata).split(" AND ")
    installed = {path.suffix for path in distribution.files or []}
    apart = NOT_INSTALLED.get(name, {})
    return [licence for licence in licences if licence not in apart or apart[licence] in installed]


def is_allowed(expression: str) -> bool:
    """Tell whether one alternative of an SPDX expression without brackets has allowed parts alone."""
    return any(set(one.split(" AND ")) <= ALLOWED for one in expression.split(" OR "))


def installed_by(requirement: str, found: dict[str, metadata.Distribution]) -> None:
    """Add all distributions that a requirement brings into this environment, by name."""
    asked = Requirement(requirement)
    if asked.name == "replant":
        for line in PROJECT["project"]["dependencies"] + [line for extra in asked.extras for line in EXTRAS[extra]]:
            installed_by(line, found)
        return
    key = str(Requirement(f"{asked.name}[{','.join(asked.extras)}]"))
    if key not in found:
        found[key] = metadata.distribution(asked.name)
        for line in found[key].requires or []:
            marker = Requirement(line).marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in {"", *asked.extras}):
                installed_by(line, found)


def test_what_developers_install_has_all_extras_but_the_peers() -> None:
    (everything,) = [Requirement(line) for line in EXTRAS["dev"] if line.startswith("replant[")]
    assert set(everything.extras) == set(EXTRAS) - {"dev", "peers"}


@every("extra", ["dev", "peers"])
def test_the_licence_of_all_that_an_extra_installs_is_known(extra: str) -> None:
    found: dict[str, metadata.Distribution] = {}
    try:
        installed_by(f"replant[{extra}]", found)
    except metadata.PackageNotFoundError as missing:
        if extra == "peers":
            pytest.skip(f"{missing.name} is not installed: only `make bench` installs the peers")
        raise
    assert {"numpy", "scipy", "click"} <= found.keys()
    licences = {name: " AND ".join(licences_of_files(name, each)) for name, each in sorted(found.items())}
    print("\n".join(f"{name:24} {licence}" for name, licence in licences.items()))
    assert {name: licence for name, licence in licences.items() if not is_allowed(licence)} == {}


def test_licences_are_told_apart() -> None:
    lesser = "License :: OSI Approved :: GNU Lesser General Public License v3 (LGPLv3)"
    for line, allowed in (
        ("License-Expression: EPL-2.0 OR BSD-3-Clause", True),
        ("License-Expression: BSD-2-Clause AND Apache-2.0 WITH LLVM-exception", True),
        ("Classifier: License :: OSI Approved :: MIT License", True),
        ("License: MIT", True),
        ("License-Expression: MIT AND GPL-3.0-only", False),
        (f"Classifier: {lesser}", False),
        (f"Classifier: License :: OSI Approved :: MIT License\nClassifier: {lesser}", False),
        ("License: mine", False),
        ("Name: nothing", False),
    ):
        assert is_allowed(licence_of(message_from_string(line))) == allowed, line
