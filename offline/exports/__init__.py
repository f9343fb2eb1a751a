"""Exports the dictionary as XTCE, COSMOS configuration and ccsdspy tables, and a page to read."""

from pathlib import Path

from fsw.errors import ConfigError
from fsw.telemetry.dictionary import DICTIONARY, Dictionary

FOLDER = "ground/dictionary"
XTCE = f"{FOLDER}/inertia.xml"


def documents(dictionary: Dictionary = DICTIONARY) -> dict[str, str]:
    """Return all exported files: path below the project's folder -> text."""
    from offline.exports import cosmos, tables
    from offline.exports.verifiers import with_names
    from offline.exports.xtce import system
    from offline.exports.xtce_commands import add_commands

    root = system(dictionary)
    add_commands(root, dictionary)
    found = {
        XTCE: with_names(root.dumps(top_comment=False)),
        f"{FOLDER}/cosmos/tlm.txt": cosmos.telemetry(dictionary),
        f"{FOLDER}/cosmos/plugin.txt": cosmos.PLUGIN,
        f"{FOLDER}/cosmos/cmd.txt": cosmos.telecommands(dictionary),
    }
    for packet in dictionary.packets:
        found[f"{FOLDER}/ccsdspy/{packet.name}.csv"] = tables.table(packet)
    return found


def write(folder: Path) -> list[Path]:
    """Write all exported files into a folder; return their paths.

    Raises
    ------
    ConfigError when a file cannot be written.
    """
    written = []
    try:
        for name, text in documents().items():
            path = folder / Path(name).relative_to(FOLDER)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            written.append(path)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from error
    return written
