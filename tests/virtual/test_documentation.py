"""The documentation: the site builds without warning or network, and every block of code holds."""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import jsonschema
import pytest
import yaml

from fsw.config.reference import json_schema
from hil.world.scenario import Document
from offline.importing.mapping import Mapping
from tests.support.commands import PROGRAMS, command_line_fault

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BESIDE = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")
PAGES = [*sorted(DOCS.rglob("*.md")), *(ROOT / name for name in BESIDE)]
BLOCK = re.compile(r"^```(\S*)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")
GENERATED = ("licences", "python", "index")  # index: a list of the others
RUN_ELSEWHERE = {"api.md": "tests/virtual/offline/test_api.py"}
MAPPINGS = "docs/import.md"  # its blocks are of fsw import, no configuration
NO_NETWORK = {f"{kind}_proxy": "http://127.0.0.1:9" for kind in ("http", "https", "all")}


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.stem)
def test_a_page_says_whom_it_is_for_and_begins_with_an_example(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    if page.stem in GENERATED:
        return
    start = "\n".join(text.splitlines()[1:25])
    assert re.search(r"^For .*[a-z]", start, re.MULTILINE)
    assert "xample" in start or "```" in start


def blocks(language: str) -> list[tuple[str, str, str]]:
    """Return page, title and text of every block in a language."""
    return [
        (str(page.relative_to(ROOT)), title.strip(), text)
        for page in PAGES
        for found, title, text in BLOCK.findall(page.read_text(encoding="utf-8"))
        if found == language
    ]


def commands_of(text: str) -> Iterator[str]:
    """Yield the command lines of our own programs in a shell script."""
    for line in text.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if set(word) <= set("();<>|&"):
                words = words[words[:1] == ["!"] :]
                program = words[0].removeprefix(".venv/bin/") if words else ""
                if program in PROGRAMS:
                    yield shlex.join([program, *words[1:]])
                words = []
            else:
                words.append(word)


def test_every_block_says_its_language():
    known = {"sh", "text", "yaml", "python"}
    for page in PAGES:
        found = {language for language, _, _ in BLOCK.findall(page.read_text(encoding="utf-8"))}
        assert found <= known, page


@pytest.mark.parametrize("page", sorted({page for page, _, _ in blocks("sh")}))
def test_commands_are_such_as_their_parsers_accept(page):
    script = "\n".join(text for where, _, text in blocks("sh") if where == page)
    done = subprocess.run(["bash", "-n"], input=script, text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    for line in commands_of(script):
        assert command_line_fault(line) == "", line


def test_a_wrong_command_in_a_block_is_found():
    script = "cd x && fsw run robot.yaml --swift | tail\nX=1; .venv/bin/hil fly > y"
    assert list(commands_of(script)) == ["fsw run robot.yaml --swift", "hil fly"]
    assert all(command_line_fault(line) for line in commands_of(script))


@pytest.mark.parametrize("text", [t for page, _, t in blocks("yaml") if page == MAPPINGS])
def test_mappings_are_such_as_their_schema_knows(text):
    assert Mapping.model_validate(yaml.safe_load(text)).sections


@pytest.mark.parametrize("text", [t for page, _, t in blocks("yaml") if page != MAPPINGS])
def test_settings_are_such_as_the_schema_knows(text):
    settings = yaml.safe_load(text)
    whole, scenario = json_schema(), Document.model_json_schema()
    for key, value in settings.items():
        schema = whole if key in whole["properties"] else scenario
        one = {"$defs": schema["$defs"], **schema["properties"][key]}
        jsonschema.validate(value, one)


@pytest.mark.parametrize("page", sorted({page for page, _, _ in blocks("python")}))
def test_python_runs(page, tmp_path, monkeypatch):
    if Path(page).name in RUN_ELSEWHERE:
        assert Path(page).name in (ROOT / RUN_ELSEWHERE[Path(page).name]).read_text()
        return
    monkeypatch.chdir(tmp_path)
    space: dict[str, object] = {"__name__": page}
    for _, _, text in (block for block in blocks("python") if block[0] == page):
        exec(compile(text, page, "exec"), space)


@pytest.mark.slow
def test_the_tutorial_does_what_it_says(tmp_path):
    """Every block runs in order in one shell; lines shown are printed, but for their figures."""
    shutil.copytree(DOCS / "inspector", tmp_path / "docs" / "inspector")
    found = BLOCK.findall((DOCS / "tutorial.md").read_text(encoding="utf-8"))
    steps = [
        (text, shown[2].splitlines() if shown[0] == "text" else [])
        for (language, title, text), shown in zip(found, [*found[1:], ("", "", "")], strict=True)
        if language == "sh" and "install" not in title
    ]
    assert len(steps) > 8
    mark = "-- next step --"
    done = subprocess.run(
        ["bash", "-eu", "-o", "pipefail", "-c", f"\necho '{mark}'\n".join(t for t, _ in steps)],
        cwd=tmp_path,
        env={
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    for (_, shown), printed in zip(steps, done.stdout.split(f"{mark}\n"), strict=True):
        lines = {NUMBER.sub("#", line) for line in printed.splitlines()}
        for line in shown:
            assert NUMBER.sub("#", line) in lines


def test_pages_that_are_made_are_those_of_code_and_data():
    path = DOCS / "generate.py"
    spec = importlib.util.spec_from_file_location("generate", path)
    assert spec is not None
    assert spec.loader is not None
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    stored = generate.EVIDENCE.read_text(encoding="utf-8")
    assert stored == generate.evidence(), "run: python docs/generate.py"
    assert stored.count("\n| ") <= 2 * stored.count("\n## ") + 40
    assert "`ENABLE_SET`" in generate.dictionary()
    keys = re.findall(r"^\| `([^`]+)`", generate.scenario(), re.MULTILINE)
    assert {"title", "sensors.joints.nodes[].sign", "environment.orbit.altitude_m"} <= set(keys)


def test_links_between_pages_lead_to_files_of_a_clone():
    for page in sorted(DOCS.rglob("*.md")):
        for link in re.findall(r"\]\(([^)\s#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            if not link.startswith("http"):
                assert (page.parent / link).exists(), f"{page.name}: {link}"


class Page(HTMLParser):
    """Collects the anchors of a page, its links, and what a browser would fetch for it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.tags: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        self.tags.add(tag)
        self.anchors |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        elif tag != "a":
            self.fetched += [values[key] for key in ("src", "href") if key in values]


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_fetches_nothing(tmp_path):
    site = tmp_path / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", site],
        cwd=ROOT,
        env={**os.environ, **NO_NETWORK, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    pages = {path: Page(path) for path in site.rglob("*.html") if path.name != "404.html"}
    assert len(pages) > 30
    for path, page in pages.items():
        assert [url for url in page.fetched if re.match(r"(https?:)?//", url)] == [], path
        for link in page.links:
            if re.match(r"https?:", link):
                continue
            place, _, anchor = unquote(link).partition("#")
            target = (path.parent / place).resolve() if place else path
            assert target.exists(), f"{path.name}: {link}"
            if target.suffix == ".html" and anchor:
                assert anchor in pages[target].anchors, f"{path.name}: {link}"
    assert "math" in pages[site / "explanation" / "estimator.html"].tags
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    assert "example: ground file rm" in commands
    assert "scheduler.tick_rate_hz" in (site / "configuration.html").read_text(encoding="utf-8")
    assert 'id="offline.api.identify"' in (site / "reference" / "python.html").read_text(
        encoding="utf-8"
    )


@pytest.mark.parametrize("name", BESIDE)
def test_links_of_the_pages_beside_lead_somewhere(name):
    for link in re.findall(r"\]\(([^)\s]+)\)", (ROOT / name).read_text(encoding="utf-8")):
        if not link.startswith("http"):
            assert (ROOT / link.partition("#")[0]).exists(), link
