"""Exports the dictionary as XTCE, COSMOS configuration and ccsdspy tables, and a page to read."""

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
