"""Service 23, with functions and reports of file transfer that are not in the standard."""

from fsw.telemetry.dictionary.codes import (
    APID_ESTIMATOR,
    FILE_KIND,
    FUNCTION,
    TRANSFER_STATE,
    YES_NO,
    Function,
)
from fsw.telemetry.dictionary.fields import choice, number, text
from fsw.telemetry.dictionary.housekeeping import PATH_BYTES
from fsw.telemetry.dictionary.types import Field, Packet, Telecommand, Type

PAGE_ENTRIES = 64  # most reports for one LIST_FILES
NAME_BYTES = 40
MAX_PIECE_BYTES = 1 << 30
MAX_U64 = (1 << 63) - 1  # XTCE writes bounds as signed numbers of 64 bits

_PATH = Field(name="path", type=Type.TEXT, size=PATH_BYTES, doc="FOLDER/NAME, as it is listed")
_TARGET = Field(name="target", type=Type.TEXT, size=PATH_BYTES)
_TRANSFER = (
    Field(name="source", type=Type.U8, doc="entity that sends the file: 1 daemon, 2 ground"),
    Field(name="number", type=Type.U64, maximum=MAX_U64, doc="of the transaction"),
)


def _tc(subtype: int, name: str, doc: str, *arguments: Field) -> Telecommand:
    return Telecommand(name=name, service=23, subtype=subtype, doc=doc, arguments=arguments)


def _function(function: Function, doc: str, *arguments: Field) -> Telecommand:
    number_field = Field(name="function_id", type=Type.U16, enumeration=FUNCTION)
    return Telecommand(
        name=function.name,
        service=8,
        subtype=1,
        doc=doc,
        arguments=(number_field, *arguments),
        match=(("function_id", int(function)),),
    )


def _report(subtype: int, name: str, doc: str, *fields: Field) -> Packet:
    return Packet(
        name=name, apid=APID_ESTIMATOR, service=23, subtype=subtype, doc=doc, fields=fields
    )


FILE_TELECOMMANDS = (
    _tc(2, "DELETE_FILE", "Remove a file", _PATH),
    _tc(3, "REPORT_FILE_ATTRIBUTES", "Report size, date and CRC of a file", _PATH),
    _tc(9, "CREATE_DIRECTORY", "Create a folder", _PATH),
    _tc(10, "DELETE_DIRECTORY", "Remove an empty folder", _PATH),
    _tc(11, "RENAME_DIRECTORY", "Rename a folder", _PATH, _TARGET),
    _tc(
        12,
        "LIST_FILES",
        f"Report {PAGE_ENTRIES} entries of a folder, by name",
        _PATH,
        Field(
            name="first",
            type=Type.U32,
            minimum=1,
            doc=f"first entry to report: 1, then {PAGE_ENTRIES + 1} and so on",
        ),
    ),
    _tc(14, "COPY_FILE", "Copy a file below the file directory", _PATH, _TARGET),
    _tc(15, "MOVE_FILE", "Move or rename a file; the target must not exist", _PATH, _TARGET),
    _tc(16, "SUSPEND_TRANSFER", "Let a file transfer rest", *_TRANSFER),
    _tc(17, "RESUME_TRANSFER", "Continue a suspended file transfer", *_TRANSFER),
    _tc(20, "ABORT_TRANSFER", "Cancel a file transfer, at both ends", *_TRANSFER),
    _function(
        Function.DOWNLINK_FILE,
        "Send a file down by CFDP",
        _PATH,
        Field(
            name="remove",
            type=Type.U8,
            enumeration=YES_NO,
            doc="remove it here once it has arrived",
        ),
    ),
    _function(
        Function.DOWNLINK_PIECE,
        "Send a piece of a file down by CFDP",
        _PATH,
        Field(name="offset", type=Type.U64, unit="B", maximum=MAX_U64),
        Field(name="size_bytes", type=Type.U32, unit="B", maximum=MAX_PIECE_BYTES),
        Field(name="name", type=Type.TEXT, size=NAME_BYTES, doc="of the piece on the ground"),
    ),
    _function(
        Function.APPEND_FILE,
        "Append a file to another one and remove it",
        _PATH,
        _TARGET,
        Field(
            name="offset",
            type=Type.U64,
            unit="B",
            maximum=MAX_U64,
            doc="size of the target before; 0: it may be missing",
        ),
    ),
    _function(Function.REPORT_TRANSFERS, "Report the file transfers that are not over"),
    _function(Function.REPORT_FREE_SPACE, "Report the space of each folder"),
)

FILE_REPORTS = (
    _report(
        4,
        "file_attributes",
        "Attributes of a file",
        text("path", PATH_BYTES),
        number("size_bytes", Type.U64, "B"),
        number("modified_s", Type.F64, "s", "Unix time"),
        number("crc32", Type.U32),
    ),
    _report(
        13,
        "file_entry",
        "One entry of a folder",
        number("entry", Type.U32, doc="from 1; 0: none from the first that was requested on"),
        number("entries", Type.U32, doc="in the folder; more than the last entry: ask for more"),
        choice("kind", FILE_KIND),
        text("path", PATH_BYTES),
        number("size_bytes", Type.U64, "B"),
    ),
    _report(
        23,
        "transfer_status",
        "One file transfer that is not over",
        number("entry", Type.U16, doc="from 1; 0: there is none"),
        number("entries", Type.U16),
        number("source", Type.U8, doc="entity that sends the file: 1 daemon, 2 ground"),
        number("number", Type.U64, doc="of the transaction"),
        text("path", PATH_BYTES, "name of the file"),
        number("size_bytes", Type.U64, "B", "0: not known yet"),
        number("done_bytes", Type.U64, "B"),
        choice("state", TRANSFER_STATE),
    ),
    _report(
        130,
        "file_space",
        "Space of the disk that holds a folder",
        text("path", PATH_BYTES),
        number("total_bytes", Type.U64, "B"),
        number("free_bytes", Type.U64, "B"),
    ),
)
