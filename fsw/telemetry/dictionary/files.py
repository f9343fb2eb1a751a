"""Service 23, with functions and reports of file transfer that are not in the standard."""

from fsw.telemetry.dictionary.codes import FILE_KIND, TRANSFER_STATE, YES_NO, Function
from fsw.telemetry.dictionary.fields import choice, number, text
from fsw.telemetry.dictionary.housekeeping import PATH_BYTES
from fsw.telemetry.dictionary.shapes import function, report, telecommand
from fsw.telemetry.dictionary.types import Field, Type

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


FILE_TELECOMMANDS = (
    telecommand(23, 2, "DELETE_FILE", "Remove a file", _PATH),
    telecommand(23, 3, "REPORT_FILE_ATTRIBUTES", "Report size, date and CRC of a file", _PATH),
    telecommand(23, 9, "CREATE_DIRECTORY", "Create a folder", _PATH),
    telecommand(23, 10, "DELETE_DIRECTORY", "Remove an empty folder", _PATH),
    telecommand(23, 11, "RENAME_DIRECTORY", "Rename a folder", _PATH, _TARGET),
    telecommand(
        23,
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
    telecommand(23, 14, "COPY_FILE", "Copy a file below the file directory", _PATH, _TARGET),
    telecommand(
        23, 15, "MOVE_FILE", "Move or rename a file; the target must not exist", _PATH, _TARGET
    ),
    telecommand(23, 16, "SUSPEND_TRANSFER", "Let a file transfer rest", *_TRANSFER),
    telecommand(23, 17, "RESUME_TRANSFER", "Continue a suspended file transfer", *_TRANSFER),
    telecommand(23, 20, "ABORT_TRANSFER", "Cancel a file transfer, at both ends", *_TRANSFER),
    function(
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
    function(
        Function.DOWNLINK_PIECE,
        "Send a piece of a file down by CFDP",
        _PATH,
        Field(name="offset", type=Type.U64, unit="B", maximum=MAX_U64),
        Field(name="size_bytes", type=Type.U32, unit="B", maximum=MAX_PIECE_BYTES),
        Field(name="name", type=Type.TEXT, size=NAME_BYTES, doc="of the piece on the ground"),
    ),
    function(
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
    function(Function.REPORT_TRANSFERS, "Report the file transfers that are not over"),
    function(Function.REPORT_FREE_SPACE, "Report the space of each folder"),
)

FILE_REPORTS = (
    report(
        23,
        4,
        "file_attributes",
        "Attributes of a file",
        text("path", PATH_BYTES),
        number("size_bytes", Type.U64, "B"),
        number("modified_s", Type.F64, "s", "Unix time"),
        number("crc32", Type.U32),
    ),
    report(
        23,
        13,
        "file_entry",
        "One entry of a folder",
        number("entry", Type.U32, doc="from 1; 0: none from the first that was requested on"),
        number("entries", Type.U32, doc="in the folder; more than the last entry: ask for more"),
        choice("kind", FILE_KIND),
        text("path", PATH_BYTES),
        number("size_bytes", Type.U64, "B"),
    ),
    report(
        23,
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
    report(
        23,
        130,
        "file_space",
        "Space of the disk that holds a folder",
        text("path", PATH_BYTES),
        number("total_bytes", Type.U64, "B"),
        number("free_bytes", Type.U64, "B"),
    ),
)
