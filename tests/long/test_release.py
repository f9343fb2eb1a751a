"""What is released: wheel, sdist, their contents, licences, bill of materials, Containerfile."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from release.inventory import NAME, closure
from release.try_container import instructions

ROOT = Path(__file__).parents[2]
PACKAGES = ("evidence", "file_delivery", "fsw", "ground", "hil", "offline", "planner")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def run(*words: object, **more: object) -> subprocess.CompletedProcess[str]:
    """Run a tool; its output is the message where it fails."""
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, **more
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Wheel and sdist, as `python -m build` makes them, but with the tools that are here."""
    out = tmp_path_factory.mktemp("dist")
    done = run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, ROOT)
    assert not re.findall(r".*(?:Warning|WARNING|deprecated).*", done.stdout + done.stderr)
    return out


@pytest.mark.slow
def test_wheel_and_sdist_are_complete_and_hold_nothing_else(dist):
    (wheel,), (sdist,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
    run(sys.executable, "-m", "twine", "check", "--strict", wheel, sdist)
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    here = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert held == here
    with tarfile.open(sdist) as archive:
        tops = {name.split("/")[1] for name in archive.getnames() if "/" in name}
    extra = {"inertia_daemon.egg-info", "setup.cfg", "PKG-INFO", "pyproject.toml", "MANIFEST.in"}
    texts = {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "Containerfile"}
    assert tops == {*PACKAGES, *extra, *texts}


@pytest.mark.slow
def test_the_wheel_alone_gives_every_command(dist, tmp_path):
    """In a fresh environment; the dependencies are those of the tests, found by a path file."""
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv")
    python = tmp_path / "venv" / "bin" / "python"
    (site,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    here = sysconfig.get_path("purelib")
    (site / "here.pth").write_text(f"import site; site.addsitedir({here!r})\n")
    (wheel,) = dist.glob("*.whl")
    install = ("install", "-q", "--no-deps", "--no-index", "--ignore-installed")
    run(sys.executable, "-m", "pip", "--python", python, *install, wheel)
    alone = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    said = run(python, "-c", "import fsw; print(fsw.__file__)", cwd=tmp_path, env=alone).stdout
    assert Path(said.strip()).is_relative_to(site)
    for name in PROJECT["scripts"]:
        said = run(python.with_name(name), "--version", cwd=tmp_path, env=alone).stdout
        assert said == f"{name} {PROJECT['version']}\n"
    assert "stim300" in run(python.with_name("fsw"), "init", "list", cwd=tmp_path, env=alone).stdout
    assert "PING" in run(python.with_name("ground"), "list", cwd=tmp_path, env=alone).stdout


def test_the_version_is_in_the_changelog():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## \[{re.escape(PROJECT['version'])}\] - \d{{4}}-\d\d-\d\d$", text, re.M)


def test_the_page_of_the_licences_has_every_direct_dependency():
    """What these bring along changes with their versions, so it is not compared."""
    said = run(sys.executable, ROOT / "release" / "inventory.py", "licences").stdout
    page = (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")
    assert said.partition("| annotated")[0] == page.partition("| annotated")[0]
    assert "UNKNOWN" not in said + page
    for need in map(Requirement, PROJECT["dependencies"]):
        row = f"| {canonicalize_name(need.name)} |"
        assert row in said
        assert row in page, "python release/inventory.py licences > docs/licences.md"


def test_the_flight_installation_is_small():
    assert "MB" in run(sys.executable, ROOT / "release" / "inventory.py", "sizes").stdout


@pytest.mark.slow
def test_the_bill_of_materials_names_every_dependency(tmp_path):
    words = ("environment", "--no-validate", "--pyproject", ROOT / "pyproject.toml")
    out = tmp_path / "sbom.json"
    run(Path(sys.executable).with_name("cyclonedx-py"), *words, "-o", out, sys.executable)
    sbom = json.loads(out.read_text(encoding="utf-8"))
    assert sbom["bomFormat"] == "CycloneDX"
    named = {part["name"].lower().replace("_", "-") for part in sbom["components"]}
    assert closure(NAME) - {NAME} <= named


def test_the_containerfile_fits_the_project():
    """Its instructions are carried out by release/try_container.py, which needs a Debian tree."""
    found = list(instructions(ROOT / "Containerfile"))
    assert [rest.split()[0] for key, rest in found if key == "FROM"] == ["debian:12-slim"] * 2
    copied = [rest.split()[:-1] for key, rest in found if key == "COPY" and "--from" not in rest]
    names = {name for group in copied for name in group}
    assert all((ROOT / name).exists() for name in names)
    assert {*PACKAGES, "pyproject.toml", PROJECT["readme"], "LICENSE"} <= names
    assert ("ENTRYPOINT", '["fsw"]') in found
    assert [rest for key, rest in found if key == "USER"] == ["fsw"], "not root"
