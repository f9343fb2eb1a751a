"""Service 23: files and folders of the daemon."""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path, PurePosixPath

from file_delivery.paths import HIDDEN
from file_delivery.room import check_room
from fsw.messages.recording_name import is_recording
from fsw.telemetry.dictionary.codes import FILE_KIND, Error
from fsw.telemetry.dictionary.files import PAGE_ENTRIES
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.eventing import SECURITY_NAME
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.file_pieces import append, checksum, copy
from fsw.telemetry.services.long_work import Pieces
from fsw.telemetry.state.command_log import COMMANDS_NAME

RECORDINGS = "recordings"
MAX_DEPTH = 8  # most parts of a folder's name
# files of the state directory that the ground may read
LOGS = ("events.jsonl", COMMANDS_NAME, SECURITY_NAME, "status.json")


class Filing:
    """Works on the daemon's files by the names that the ground uses: FOLDER/NAME, or NAME of a log.

    The folders are `files`, in which file delivery works, and `recordings`, of which only the
    recorder's own files have names. The logs lie in the state directory and can only be read.
    """

    def __init__(self, context: TelemetryContext) -> None:
        self._context, config = context, context.config
        self._folders = {"files": context.state / context.telemetry.file_directory}
        if config.recorder.directory is not None:
            self._folders[RECORDINGS] = config.resolve(config.recorder.directory)
        self._in_work: set[Path] = set()  # files that are being copied or appended
        self._single = {name: context.state / name for name in LOGS}

    def make_folder(self) -> None:
        """Make the folder of file delivery if it is missing. Raises OSError."""
        self._folders["files"].mkdir(parents=True, exist_ok=True)

    def find(self, name: str, argument: int = 1) -> Path:
        """Return the path for a name. Raises TcError BAD_ARG for a path outside of the folders."""
        if name in self._single:
            return self._single[name]
        parts = PurePosixPath(name).parts
        root = self._folders.get(parts[0]) if parts else None
        if root is None or any(part.startswith(HIDDEN) for part in parts):
            begins = f"must begin with one of {sorted(self._folders)}, no part with {HIDDEN!r}"
            raise TcError(Error.BAD_ARG, argument, text=f"{name!r}: {begins}")
        if parts[0] == RECORDINGS and not _is_recording(parts[1:]):
            raise TcError(Error.BAD_ARG, argument, text=f"{name!r}: not the name of a recording")
        path = root.joinpath(*parts[1:])
        try:
            inside = path.resolve().is_relative_to(root.resolve())
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links
            raise TcError(Error.BAD_ARG, argument, text=f"{name!r}: {error}") from error
        if not inside:
            raise TcError(Error.BAD_ARG, argument, text=f"{name!r} leads outside")
        return path

    def existing(self, name: str) -> Path:
        """Return the path of an existing file for a name.

        Raises
        ------
        TcError FILE_NOT_FOUND; BAD_ARG for a path outside of the folders.
        """
        path = self.find(name)
        if not path.is_file():
            raise TcError(Error.FILE_NOT_FOUND, 1)
        return path

    def free(self, path: Path) -> Path:
        """Return the path itself. Raises TcError BUSY while the daemon uses or writes this file."""
        recording = self._context.host.recording
        if recording.values()["recording"] and path == recording.path:
            raise TcError(Error.BUSY, 1, text="it is being written")
        if any(path == used or path in used.parents for used in self._in_work):
            raise TcError(Error.BUSY, 1, text="it is being copied or appended")
        return path

    def writable(self, name: str, argument: int = 1) -> Path:
        """Return the path of an entry that may be created or removed. Raises TcError."""
        path = self.find(name, argument)
        if name in self._single or len(PurePosixPath(name).parts) < 2:
            raise TcError(Error.BAD_ARG, argument, text=f"{name!r} cannot be written")
        return path

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "DELETE_FILE": self._delete,
            "REPORT_FILE_ATTRIBUTES": self._attributes,
            "LIST_FILES": self._list,
            "COPY_FILE": self._copy,
            "MOVE_FILE": self._move,
            "APPEND_FILE": self._append,
            "CREATE_DIRECTORY": self._create_folder,
            "DELETE_DIRECTORY": self._delete_folder,
            "RENAME_DIRECTORY": self._move,
            "REPORT_FREE_SPACE": self._space,
        }

    def _delete(self, request: Request) -> Action:
        path = self.free(self.writable(request.text("path")))
        if not path.is_file() and not path.is_symlink():
            raise TcError(Error.FILE_NOT_FOUND, 1)
        return partial(guarded, path.unlink)

    def _attributes(self, request: Request) -> Action:
        path = self.existing(request.text("path"))

        def pieces() -> Pieces:
            facts = path.stat()
            values = {
                "path": request.text("path"),
                "size_bytes": facts.st_size,
                "modified_s": facts.st_mtime,
                "crc32": (yield from checksum(path, 0, facts.st_size)),
            }
            yield "file_attributes", values

        return self._context.long_work.action(request, pieces)

    def _list(self, request: Request) -> Action:
        name, first = request.text("path"), request.whole("first")
        path = self.find(name)
        if not path.is_dir():
            raise TcError(Error.FILE_NOT_FOUND, 1)

        shown = is_recording if path == self._folders.get(RECORDINGS) else _is_shown
        return self._context.long_work.action(request, partial(_page, path, name, first, shown))

    def _copy(self, request: Request) -> Action:
        source = self.free(self.existing(request.text("path")))
        target = self._new(request.text("target"))
        return self._work(
            request, copy(source, target, self._context.reserve_bytes), source, target
        )

    def _move(self, request: Request) -> Action:
        """Rename a file or a folder."""
        source = self.free(self.writable(request.text("path")))
        target = self._new(request.text("target"))
        wanted = source.is_file() if request.telecommand.name == "MOVE_FILE" else source.is_dir()
        if not wanted:
            raise TcError(Error.FILE_NOT_FOUND, 1)
        return partial(guarded, partial(source.rename, target))

    def _append(self, request: Request) -> Action:
        source = self.free(self.existing(request.text("path")))
        target = self.free(self.writable(request.text("target"), 2))
        self.writable(request.text("path"))
        if target.exists() and target.samefile(source):
            raise TcError(Error.BAD_ARG, 2, text="it is the same file")
        offset = request.whole("offset")
        there = target.stat().st_size if target.is_file() else 0
        if there != offset:
            raise TcError(Error.OUT_OF_RANGE, 3, there, text=f"the target has {there} bytes")
        return self._work(
            request, append(source, target, offset, self._context.reserve_bytes), source, target
        )

    def _work(self, request: Request, pieces: Iterator[None], *paths: Path) -> Action:
        """Return an action that begins work on files, which are locked until the work ends."""

        def guarded_pieces() -> Pieces:
            self._in_work.update(paths)
            try:
                yield from pieces
            finally:
                self._in_work.difference_update(paths)

        return self._context.long_work.action(request, guarded_pieces)

    def _new(self, name: str) -> Path:
        """Return the path of a new entry. Raises TcError."""
        target = self.writable(name, 2)
        if target.exists() or target.is_symlink():
            raise TcError(Error.BUSY, 2, text=f"{name} exists")
        return self.free(target)

    def _create_folder(self, request: Request) -> Action:
        name = request.text("path")
        path = self.writable(name)
        if path.exists():
            raise TcError(Error.BUSY, 1, text=f"{name} exists")
        if len(PurePosixPath(name).parts) > MAX_DEPTH:
            raise TcError(Error.OUT_OF_RANGE, 1, text=f"more than {MAX_DEPTH} folders")
        return partial(guarded, partial(self._make_folder, path))

    def _make_folder(self, path: Path) -> None:
        check_room(path.parent, self._context.reserve_bytes, new_file=True)
        path.mkdir()

    def _delete_folder(self, request: Request) -> Action:
        path = self.writable(request.text("path"))
        if not path.is_dir():
            raise TcError(Error.FILE_NOT_FOUND, 1)
        return partial(guarded, path.rmdir)

    def _space(self, _request: Request) -> Action:
        def act() -> None:
            for name, path in self._folders.items():
                if not path.is_dir():
                    continue
                room = shutil.disk_usage(path)
                values = {"path": name, "total_bytes": room.total, "free_bytes": room.free}
                self._context.down.send("file_space", values)

        return partial(guarded, act)


def _is_recording(parts: Sequence[str]) -> bool:
    """Return whether a path below `recordings` is that folder or a file of the recorder."""
    return not parts or (len(parts) == 1 and is_recording(parts[0]))


def _is_shown(name: str) -> bool:
    return not name.startswith(HIDDEN)


def _page(
    path: Path, name: str, first: int, shown: Callable[[str], bool]
) -> list[tuple[str, Mapping[str, object]]]:
    """Return at most `PAGE_ENTRIES` of the shown entries of a folder as packets. Raises OSError."""
    with os.scandir(path) as found:
        entries = sorted((e for e in found if shown(e.name)), key=lambda item: item.name)
    total, page = len(entries), entries[first - 1 : first - 1 + PAGE_ENTRIES]
    packets = []
    for place, item in enumerate(page, start=first):
        kind = _kind(item)
        size = item.stat(follow_symlinks=False).st_size if kind == "FILE" else 0
        packets.append(_entry(place, total, kind, f"{name.rstrip('/')}/{item.name}", size))
    return packets or [_entry(0, total, "FILE", name, 0)]


def _entry(
    place: int, total: int, kind: str, path: str, size: int
) -> tuple[str, Mapping[str, object]]:
    values = {
        "entry": place,
        "entries": total,
        "kind": FILE_KIND.value(kind),
        "path": path,
        "size_bytes": size,
    }
    return "file_entry", values


def _kind(item: os.DirEntry[str]) -> str:
    """Return the kind of an entry; links are not followed."""
    if item.is_dir(follow_symlinks=False):
        return "FOLDER"
    return "FILE" if item.is_file(follow_symlinks=False) else "OTHER"


def guarded(act: Callable[[], object]) -> Done:
    """Call `act`. Raises TcError FAILED with the text of a system error."""
    try:
        act()
    except OSError as error:
        raise _failed(error) from error
    return Done.NOW


def _failed(error: OSError) -> TcError:
    return TcError(Error.FAILED, text=f"{error.filename}: {error.strerror}")
