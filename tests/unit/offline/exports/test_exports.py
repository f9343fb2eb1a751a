"""The checked-in exports: as the dictionary is, and read by tools nobody here wrote."""

import csv
import io
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from fsw.__main__ import main
from fsw.telemetry.dictionary import DICTIONARY, Packet, Type
from tests.support.packing import pack, random_values

pytest.importorskip("yamcs.pymdb", reason="needs yamcs-pymdb: pip install '.[ground]'")
spp = pytest.importorskip(
    "space_packet_parser", reason="needs space_packet_parser: pip install '.[ground]'"
)

from offline.exports import FOLDER, XTCE, documents  # noqa: E402
from offline.exports.single import single_commands  # noqa: E402
from offline.exports.xtce import system  # noqa: E402

ROOT = Path(__file__).parents[4]
X = "{http://www.omg.org/spec/XTCE/20180204}"
PACKETS = [pytest.param(packet, id=packet.name) for packet in DICTIONARY.packets]


@pytest.fixture(scope="module")
def exports() -> dict[str, str]:
    return documents()


@pytest.fixture(scope="module")
def definition():
    return spp.load_xtce(ROOT / XTCE)


def test_the_checked_in_files_are_what_the_dictionary_gives(exports):
    for name, text in exports.items():
        assert (ROOT / name).read_text(encoding="utf-8") == text, (
            f"{name} is not up to date: python -m offline.exports"
        )


def test_the_command_writes_the_same_files(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["export", "dictionary", "--out", str(out)]) == 0
    told = [Path(line).relative_to(out) for line in capsys.readouterr().out.splitlines()]
    assert len(told) > 50
    for name in told:
        assert (out / name).read_bytes() == (ROOT / FOLDER / name).read_bytes()


def test_a_disk_that_refuses_the_files_is_one_line(tmp_path, capsys):
    (tmp_path / "file").touch()
    assert main(["export", "dictionary", "--out", str(tmp_path / "file" / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("cannot be written: Not a directory")


def test_no_file_is_left_of_a_packet_that_is_no_more(exports):
    kept = {
        str(path.relative_to(ROOT))
        for path in (ROOT / FOLDER).rglob("*.[xct]*")
        if "__pycache__" not in path.parts  # of a test that ran `ground` from here
    }
    assert kept == set(exports)


def test_the_telemetry_part_is_valid_at_every_level(tmp_path):
    path = tmp_path / "telemetry.xml"
    path.write_text(system(DICTIONARY).dumps(), encoding="utf-8")
    result = spp.validate_xtce(path, level="all", allow_schema_download=False)
    assert result.valid, result.errors


def test_the_whole_document_is_valid_by_the_schema():
    result = spp.validate_xtce(ROOT / XTCE, level="schema", allow_schema_download=False)
    assert result.valid, result.errors


def _shared(packet: Packet) -> list[str]:
    """Return the fields up to the one that tells packets of one service and subtype apart."""
    names = [item.name for item in packet.fields]
    return names[: 1 + names.index(packet.match[0][0])] if packet.match else []


@pytest.mark.parametrize("packet", PACKETS)
def test_space_packet_parser_gives_every_value_back_bit_by_bit(definition, packet):
    rng = np.random.default_rng(5)
    values = random_values(packet, rng)
    raw = pack(packet, values, count=77)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parsed = definition.parse_bytes(raw)
    assert parsed["header_sequence_count"] == 77
    if packet.secondary_header:
        seconds = parsed["header_time_coarse_s"] + parsed["header_time_fine"] / 2**24
        assert seconds == 1.5
    shared = f"service_{packet.service}_{packet.subtype}"
    for item in packet.fields:
        first = item.name in _shared(packet)
        found = parsed[f"{shared if first else packet.name}_{item.name}"]
        if item.enumeration is not None and not first:
            assert found == item.enumeration.labels[values[item.name]]
            assert found.raw_value == values[item.name]
        elif item.type is Type.TEXT:
            assert found.rstrip("\0") == values[item.name]
        else:
            assert found == values[item.name]
    assert parsed["crc16"] == int.from_bytes(raw[-2:], "big")


@pytest.mark.parametrize("packet", PACKETS)
def test_ccsdspy_reads_a_stream_of_every_packet_by_its_table(packet):
    ccsdspy = pytest.importorskip("ccsdspy", reason="needs ccsdspy: pip install '.[ground]'")
    rng = np.random.default_rng(6)
    rows = [random_values(packet, rng) for _ in range(3)]
    stream = io.BytesIO(b"".join(pack(packet, row, k) for k, row in enumerate(rows)))
    table = ccsdspy.FixedLength.from_file(str(ROOT / FOLDER / "ccsdspy" / f"{packet.name}.csv"))
    found = table.load(stream, include_primary_header=True)
    assert list(found["CCSDS_SEQUENCE_COUNT"]) == [0, 1, 2]
    for item in packet.fields:
        for k, row in enumerate(rows):
            value = found[item.name][k]
            if item.type is Type.TEXT:
                value = bytes(value).rstrip(b"\0").decode()
            assert value == row[item.name], item.name


def test_cosmos_items_have_the_sizes_of_the_dictionary():
    text = (ROOT / FOLDER / "cosmos" / "tlm.txt").read_text()
    found: dict[str, int] = {}
    name = ""
    for line in text.splitlines():
        words = line.split()
        if words and words[0] == "TELEMETRY":
            name = words[2]
            found[name] = 0
        elif words and words[0] in ("APPEND_ITEM", "APPEND_ID_ITEM"):
            found[name] += int(words[2])
    headers = {True: 6 + 15 + 2, False: 6 + 2}
    assert found == {
        packet.name.upper(): 8 * (packet.size_bytes + headers[packet.secondary_header])
        for packet in DICTIONARY.packets
    }


@pytest.fixture(scope="module")
def metacommands() -> dict[str, ET.Element]:
    root = ET.parse(ROOT / XTCE).getroot()
    return {str(item.get("name")): item for item in root.iter(f"{X}MetaCommand")}


def test_xtce_has_a_verifier_for_every_report_of_every_command(metacommands):
    kinds = {1: "AcceptedVerifier", 3: "ExecutionVerifier", 5: "ExecutionVerifier"}
    for command in single_commands(DICTIONARY):
        found = [item.tag for item in metacommands[command.name].find(f"{X}VerifierSet")]
        reports = command.telecommand.verification
        assert found == [X + kinds.get(subtype, "CompleteVerifier") for subtype in reports]
        names = [
            item.get("name") for item in metacommands[command.name].iter(f"{X}CustomAlgorithm")
        ]
        assert len(set(names)) == len(reports)  # Yamcs runs one of a name
    timeout = metacommands["RUN_BATCH"].find(f".//{X}CompleteVerifier/{X}CheckWindow")
    assert timeout.get("timeToStopChecking") == "PT1H"


def test_xtce_has_the_significance_of_every_command(metacommands):
    for command in single_commands(DICTIONARY):
        level = metacommands[command.name].find(f"{X}DefaultSignificance")
        assert level.get("consequenceLevel") == command.telecommand.significance
        assert level.get("reasonForWarning", "") == command.telecommand.hazard


def test_xtce_and_ccsdspy_tables_have_the_limits_and_alarms_of_every_field():
    root = ET.parse(ROOT / XTCE).getroot()
    types = {item.get("name"): item for item in root.find(f".//{X}ParameterTypeSet")}
    count = 0
    for packet in DICTIONARY.packets:
        with (ROOT / FOLDER / "ccsdspy" / f"{packet.name}.csv").open() as file:
            rows = {row["name"]: row for row in csv.DictReader(file)}
        for item in packet.fields:
            kind, row = types.get(f"{packet.name}_{item.name}"), rows[item.name]
            if kind is None:  # shared by packets of one service and subtype
                continue
            bounds = [
                kind.find(f".//{X}{name}Range[@{side}Exclusive]")
                for name, side in (
                    ("Critical", "min"),
                    ("Warning", "min"),
                    ("Warning", "max"),
                    ("Critical", "max"),
                )
            ]
            labels = [item.get("enumerationLabel") for item in kind.iter(f"{X}EnumerationAlarm")]
            limits = item.limits
            expected = (None,) * 4
            if limits is not None:
                expected = limits.red_low, limits.yellow_low, limits.yellow_high, limits.red_high
                count += 1
            assert [bound is not None for bound in bounds] == [x is not None for x in expected]
            names = ("red_low", "yellow_low", "yellow_high", "red_high")
            told = tuple(float(row[name]) if row[name] else None for name in names)
            assert told == expected
            assert labels == [label for label, _ in item.alarms]
            assert row["alarms"] == " ".join(f"{x}:{c.name.lower()}" for x, c in item.alarms)
    assert count >= 10


def test_alarms_are_labels_of_their_field():
    for packet in DICTIONARY.packets:
        for item in packet.fields:
            labels = set() if item.enumeration is None else set(item.enumeration.labels.values())
            assert {label for label, _ in item.alarms} <= labels
