"""Service 23: what lies in the daemon's folders, and sending it down."""

from __future__ import annotations

import shutil
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path, PurePosixPath

from file_delivery.errors import DeliveryError
from fsw.config import Config
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.ports import FileDelivery, Recording
from fsw.telemetry.services.eventing import SECURITY_NAME
from fsw.telemetry.services.executor import Action, Done, Handler, Report, Send, TcDispatcher
from fsw.telemetry.state.command_log import COMMANDS_NAME

MAX_AT_ONCE_BYTES = 64 << 20  # read or copied in one go: the service has other things to do
MAX_LISTED = 256
LOGS = (
    "events.jsonl",
    COMMANDS_NAME,
    SECURITY_NAME,
    "status.json",
)  # of the state directory, that may go down


class Filing:
    """Files of the daemon by the names the ground knows: FOLDER/NAME, and a few single ones.

    Parameters
    ----------
    folders : folder names and where they are; `files` is what file delivery works in
    single : names of single files outside the folders
    writable : those of them in which files may be made and removed
    in_use : the file that is being written now
    """

    def __init__(
        self,
        folders: Mapping[str, Path],
        single: Mapping[str, Path],
        writable: tuple[str, ...],
        in_use: Callable[[], Path | None],
        send: Send,
        report: Report,
    ) -> None:
        self._folders, self._single = dict(folders), dict(single)
        self._writable, self._in_use = writable, in_use
        self._send, self._report = send, report
        self.delivery: FileDelivery | None = None
        self._sending: dict[int, tuple[Request, Path | None]] = {}
        self.dispatcher: TcDispatcher | None = None

    def find(self, name: str) -> Path:
        """Return the path a name stands for. Raises TcError when it leads outside."""
        if name in self._single:
            return self._single[name]
        parts = PurePosixPath(name).parts
        root = self._folders.get(parts[0]) if parts else None
        if root is None or ".." in parts:
            raise TcError(Error.BAD_ARG, 1, text=f"{name!r}: begins with {sorted(self._folders)}")
        path = root.joinpath(*parts[1:])
        try:
            inside = path.resolve().is_relative_to(root.resolve())
        except (OSError, RuntimeError) as error:  # a loop of links
            raise TcError(Error.BAD_ARG, 1, text=f"{name!r}: {error}") from error
        if not inside:
            raise TcError(Error.BAD_ARG, 1, text=f"{name!r} leads outside")
        return path

    def poll(self) -> None:
        """Tell what became of transfers."""
        if self.delivery is None:
            return
        for number, success, text in self.delivery.finished():
            request, remove = self._sending.pop(number, (None, None))
            if request is None:
                self._report("FILE_RECEIVED" if success else "FILE_FAILED", text)
                continue
            self._report("FILE_SENT" if success else "FILE_FAILED", text)
            if success and remove is not None:
                remove.unlink(missing_ok=True)
            error = None if success else TcError(Error.TIMEOUT, text=text)
            if self.dispatcher is not None:
                self.dispatcher.finish(request, error)

    def handlers(self) -> dict[str, Handler]:
        """Return what takes this service's telecommands."""
        return {
            "DELETE_FILE": self._delete,
            "REPORT_FILE_ATTRIBUTES": self._attributes,
            "LIST_FILES": self._list,
            "COPY_FILE": self._copy,
            "DOWNLINK_FILE": self._downlink,
        }

    def _existing(self, request: Request, argument: int = 1) -> Path:
        path = self.find(request.text("path"))
        if not path.is_file():
            raise TcError(Error.FILE_NOT_FOUND, argument)
        return path

    def _removable(self, name: str) -> None:
        if PurePosixPath(name).parts[0] not in self._writable:
            raise TcError(Error.BAD_ARG, 1, text=f"{name!r} cannot be written")

    def _delete(self, request: Request) -> Action:
        path = self._existing(request)
        self._removable(request.text("path"))
        if path == self._in_use():
            raise TcError(Error.BUSY, 1, text="it is being written")
        return partial(_guarded, path.unlink)

    def _attributes(self, request: Request) -> Action:
        path = self._existing(request)

        def act() -> None:
            facts = path.stat()
            small = facts.st_size <= MAX_AT_ONCE_BYTES
            values = {
                "path": request.text("path"),
                "size_bytes": facts.st_size,
                "modified_s": facts.st_mtime,
                "crc32": zlib.crc32(path.read_bytes()) if small else 0,
            }
            self._send("file_attributes", values)

        return partial(_guarded, act)

    def _list(self, request: Request) -> Action:
        name = request.text("path")
        path = self.find(name)
        if not path.is_dir():
            raise TcError(Error.FILE_NOT_FOUND, 1)

        def act() -> None:
            files = sorted(item for item in path.iterdir() if item.is_file())[:MAX_LISTED]
            if not files:
                empty = {"entry": 0, "entries": 0, "path": name, "size_bytes": 0}
                self._send("file_entry", empty)
            for place, item in enumerate(files, start=1):
                values = {
                    "entry": place,
                    "entries": len(files),
                    "path": f"{name.rstrip('/')}/{item.name}",
                    "size_bytes": item.stat().st_size,
                }
                self._send("file_entry", values)

        return partial(_guarded, act)

    def _copy(self, request: Request) -> Action:
        source, name = self._existing(request), request.text("target")
        target = self.find(name)
        self._removable(name)
        if target.exists():
            raise TcError(Error.BUSY, 2, text=f"{name} exists")
        size = source.stat().st_size
        if size > MAX_AT_ONCE_BYTES:
            raise TcError(Error.OUT_OF_RANGE, 1, size)

        def act() -> None:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)

        return partial(_guarded, act)

    def _downlink(self, request: Request) -> Action:
        path = self._existing(request)
        delivery = self.delivery
        if delivery is None:
            raise TcError(Error.NOT_SUPPORTED)
        if path == self._in_use():  # it would grow on its way, and have another check value
            raise TcError(Error.BUSY, 1, text="it is being written")
        remove = bool(request.whole("remove"))
        if remove:
            self._removable(request.text("path"))

        def act() -> Done:
            try:
                here = self._within_delivery(path)
                number = delivery.send(here, remove=remove or here != path)
            except DeliveryError as error:
                known = error.code in Error.__members__
                code = Error[error.code] if known else Error.FAILED
                raise TcError(code, text=str(error)) from error
            except OSError as error:
                raise TcError(Error.FAILED, text=error.strerror or str(error)) from error
            self._sending[number] = (request, path if remove and here != path else None)
            return Done.LATER

        return act

    def _within_delivery(self, path: Path) -> Path:
        """Return the file, or a second name of it in the folder that delivery works in."""
        root = self._folders["files"]
        if path.is_relative_to(root):
            return path
        outbox = root / "outbox"
        outbox.mkdir(parents=True, exist_ok=True)
        link = outbox / path.name
        link.unlink(missing_ok=True)
        try:
            link.hardlink_to(path)
        except OSError:  # on another file system
            shutil.copyfile(path, link)
        return link


def _guarded(act: Callable[[], object]) -> Done:
    try:
        act()
    except OSError as error:
        raise TcError(Error.FAILED, text=f"{error.filename}: {error.strerror}") from error
    return Done.NOW


def filing_of(
    config: Config, files: Path, recording: Recording, send: Send, report: Report
) -> Filing:
    """Return the files of a daemon.

    Parameters
    ----------
    files : the folder in which file delivery works
    """
    folders = {"files": files}
    if config.recorder.directory is not None:
        folders["recordings"] = config.resolve(config.recorder.directory)
    state = config.resolve(config.service.state_directory)
    single = {name: state / name for name in LOGS}

    def in_use() -> Path | None:
        return recording.path if recording.values()["recording"] else None

    return Filing(folders, single, tuple(folders), in_use, send, report)
