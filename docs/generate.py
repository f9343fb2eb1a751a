"""Hook of MkDocs: pages made from the code, and equations as MathML, which needs no script.

Commands come from the argument parsers, configuration keys from their declarations, scenarios from
their models, telemetry from its dictionary: the file of such a page says how to print it, and the
site has it whole. The page of figures is a file, made of `evidence.yaml` by `python
docs/generate.py`; a test compares the two.
"""

import argparse
import re
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import yaml
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from fsw.drivers.codecs.entries import options_of
from offline.init.devices import offered

ROOT = Path(__file__).parents[1]
EVIDENCE = ROOT / "docs" / "evidence.md"
OUTSIDE = {"contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}
CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
EQUATION = re.compile(r"\$\$(.+?)\$\$|(?<![\w\\$])\$([^\s$](?:[^$\n]*[^\s$])?)\$(?!\w)", re.DOTALL)
CONFIGURATION = "configuration.md"
KEYS_HEAD = ("| key | values | default | meaning |", "|---|---|---|---|")
EVIDENCE_START = """# Evidence

For anyone who wants to check a claim. Made of `evidence.yaml` by `python docs/generate.py`.

**Example.** `.venv/bin/hil seeds target_leo --first 100 --count 10` runs ten seeds of the standard
scenario and prints the mean normalised error with its 99 % band.

Each row has a command that anyone can run and the commit at which it ran; bounds stood in the code
before the figures. Long commands continue from the folder given with `--out`. NEES is the mean
squared error over the covariance, *of* its expected value, with the 99 % band (95 % in real time);
of ten parameters it is [6.73, 14.02] for 10 seeds, [7.61, 12.76] for 20.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, and those that stand beside the folder of the documentation."""
    pages = {
        "reference/codecs.md": codecs(),
    }
    for name, source in OUTSIDE.items():
        pages[name] = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](")
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))
    return files


def codecs() -> str:
    """Return the page of the installed codecs: what each reads, and its options."""
    parts = [
        "# Codecs",
        "For users who connect an inertial unit or a star tracker. Generated from the codecs; "
        "`fsw devices` lists those of your installation. "
        "[Add a sensor driver](../howto/sensor_driver.md) says how to write one.",
    ]
    for entry, kind, codec in offered():
        options = [f"- `{option}`" for option in options_of(codec).values()]
        document = import_module(codec.__module__).__doc__
        parts += [f"## {entry.name} ({kind})", f"{codec.title}. {document}", "\n".join(options)]
    return "\n\n".join(parts)


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Give links to files outside their pages, and equations their MathML; code stays."""
    if page.file.src_uri in WHOLE:
        markdown += WHOLE[page.file.src_uri]()
    if page.file.src_uri == CONFIGURATION:
        markdown = with_keys(markdown)
    for name, source in OUTSIDE.items():
        markdown = markdown.replace(f"](../{source})", f"]({name})")
    parts = CODE.split(markdown)
    return "".join(part if k % 2 else EQUATION.sub(_mathml, part) for k, part in enumerate(parts))


def on_post_page(output: str, page: Page, **_: object) -> str:
    """Lead the links of a notebook to pages; MkDocs does so for Markdown only."""
    if not page.file.src_uri.endswith(".ipynb"):
        return output
    return re.sub(r'href="(?!https?:)([^"#]+)\.(?:md|ipynb)(?=["#])', r'href="\1.html', output)


def with_keys(markdown: str) -> str:
    """Return the page of the configuration with the table of keys at the end of each section."""
    keys_of = import_module("fsw.config.reference").keys_of
    head, *sections = re.split(r"^### (?=\w+$)", markdown, flags=re.MULTILINE)
    parts = [head]
    for section in sections:
        rows = [key.row() for key in keys_of(section.partition("\n")[0])]
        parts.append("\n".join([f"### {section.rstrip()}", "", *KEYS_HEAD, *rows, "", ""]))
    return "".join(parts)


def _mathml(found: re.Match[str]) -> str:
    block, inline = found.groups()
    if block:
        return convert(block.strip(), display="block")
    return f"<span>{convert(inline)}</span>"  # a line may not begin with a block's tag


def commands() -> str:
    """Return the help of every command, from the parsers."""
    lines = ["", ""]
    for program in ("fsw", "hil", "ground"):
        parser: argparse.ArgumentParser = import_module(f"{program}.__main__").parser()
        for depth, one in _tree(parser, 2):
            lines += [f"{'#' * depth} {one.prog}", "", "```text", _help(one), "```", ""]
    return "\n".join(lines)


def _help(parser: argparse.ArgumentParser) -> str:
    """Return a parser's help, 100 columns wide wherever it is made."""
    parser.formatter_class = lambda prog: argparse.HelpFormatter(prog, width=100)
    return parser.format_help().rstrip()


def _tree(
    parser: argparse.ArgumentParser, depth: int
) -> Iterator[tuple[int, argparse.ArgumentParser]]:
    yield depth, parser
    for action in parser._actions:  # noqa: SLF001  # argparse shows them nowhere else
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                yield from _tree(inner, depth + 1)


def scenario() -> str:
    """Return the page of every key of a scenario of the bench, from its models."""
    lines = []
    for name, keys in import_module("hil.scenario_keys").sections().items():
        title = f"Section `{name}`" if name else "The file"
        lines += [f"## {title}", "", *KEYS_HEAD, *(key.row() for key in keys), ""]
    return "\n".join(lines)


def dictionary() -> str:
    """Return the tables of every packet, telecommand, parameter and event."""
    text: str = import_module("offline.exports.page").page()
    return text


def evidence() -> str:
    """Return the page of figures."""
    data = yaml.safe_load(EVIDENCE.with_suffix(".yaml").read_text(encoding="utf-8"))
    lines = [EVIDENCE_START, f"Machine: {data['machine']}.", ""]
    for title, rows in data["sections"].items():
        lines += [f"## {title}", "", "| question | command | it gave |", "|---|---|---|"]
        for row in rows:
            short = "*short:* " * row.get("short", False)
            made = f"`{row['command']}` [{row['commit']}]"
            lines.append(f"| {row['asked']} | {made} | {short}{row['gave']} |")
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


# pages whose file says how to print them, and what the site appends
WHOLE: dict[str, Callable[[], str]] = {
    "reference/commands.md": commands,
    "reference/scenario.md": scenario,
    "dictionary.md": dictionary,
}

if __name__ == "__main__":
    EVIDENCE.write_text(evidence(), encoding="utf-8")
