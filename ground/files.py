"""The `file` subcommands: file transfers, and management of the daemon's folders."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from file_delivery.numbers import Numbers
from ground.commands import Catalogue
from ground.delivery import NOT_FOUND, Delivery, RefusedError
from ground.errors import GroundError, LinkError
from ground.link import Link
from ground.state_folder import made
from ground.telemetry import TelemetryDecoder
from ground.transfers import Connect, Records, ResumableTransfer, SpoiledError, carry_on

RECORDS, NUMBERS = "transfers", "transactions"  # in the state folder
EVERY_S = 5.0  # between two lines of progress if stderr is not a terminal
PLACE = "/"  # separates source and number of a transaction

LinkMaker = Callable[[], Link]


class Files:
    """Runs one `file` subcommand; the public methods return the exit code.

    Parameters
    ----------
    make_link : opens a link to the daemon
    """

    def __init__(self, arguments: argparse.Namespace, make_link: LinkMaker) -> None:
        self._arguments, self._make_link = arguments, make_link
        self._catalogue, self._decoder = Catalogue(), TelemetryDecoder()
        state = made(arguments.state.expanduser())
        self._records, self._numbers = Records(state / RECORDS), Numbers(state / NUMBERS)
        self._until_s = time.monotonic() + arguments.timeout
        self._progress = ProgressLines()

    def get(self) -> int:
        """Fetch a file from the daemon."""
        remote = self._arguments.remote
        local = (self._arguments.local or Path(PurePosixPath(remote).name)).absolute()
        return self._run(
            ResumableTransfer.get(
                remote, local, self._records, self._progress, self._arguments.piece
            )
        )

    def put(self) -> int:
        """Send a file to the daemon."""
        remote = self._arguments.remote or self._arguments.local.name
        local = self._arguments.local.absolute()
        return self._run(
            ResumableTransfer.put(
                remote, local, self._records, self._progress, self._arguments.piece
            )
        )

    def resume(self) -> int:
        """Continue one interrupted transfer, or all of them."""
        wanted = self._arguments.id
        records = self._records.all() if wanted is None else [self._records.find(wanted)]
        if not records:
            print("nothing to resume")
        codes = []
        for record in records:
            try:
                codes.append(self._run(ResumableTransfer(record, self._records, self._progress)))
            except GroundError as error:
                print(f"ground: {error}", file=sys.stderr)
                codes.append(error.exit_code)
        return max(codes, default=0)

    def cancel(self) -> int:
        """Cancel a transfer: one of this state folder by its id, one on board by SOURCE/NUMBER."""
        name = self._arguments.id
        source, place, number = name.partition(PLACE)
        if place:
            return self._tell_daemon("ABORT_TRANSFER", source=source, number=number)
        transfer = ResumableTransfer(self._records.find(name), self._records, self._progress)
        transfer.discard(None)  # this ends a program that runs the transfer
        try:
            with self._connected()() as delivery:
                transfer.discard(delivery)
        except LinkError as error:
            if transfer.record.direction == "put":
                print(f"ground: {error}: its pieces on board are left", file=sys.stderr)
        print(f"{name}: cancelled")
        return 0

    def transfers(self) -> int:
        """List the unfinished transfers: those of this state folder, then those on board."""
        for record in self._records.all():
            print(
                f"{record.id}  {record.direction}  {record.size:12d}  "
                f"{record.remote}  {record.local}"
            )
        with self._connected()() as delivery:
            for sample in delivery.ask("REPORT_TRANSFERS"):
                v = sample.values
                if v["entry"]:
                    done = f"{v['done_bytes']:>12} of {v['size_bytes']:>12}"
                    print(f"{v['source']}{PLACE}{v['number']}  {v['state']}  {done}  {v['path']}")
        return 0

    def list(self) -> int:
        """List a folder, page by page."""
        first, total = 1, 0
        with self._connected()() as delivery:
            while True:
                page = delivery.ask("LIST_FILES", path=self._arguments.remote, first=str(first))
                entries = [sample.values for sample in page if sample.values["entry"]]
                for values in entries:
                    size = values["size_bytes"] if values["kind"] == "FILE" else values["kind"]
                    print(f"{size:>12}  {values['path']}")
                last = int(page[-1].values["entries"])
                if total and last != total:
                    print("ground: the folder changed meanwhile; list it again", file=sys.stderr)
                total, first = last, first + len(entries)
                if not entries or first > total:
                    return 0

    def free(self) -> int:
        """Show the free space of each folder."""
        with self._connected()() as delivery:
            for sample in delivery.ask("REPORT_FREE_SPACE"):
                v = sample.values
                print(f"{v['free_bytes']:>16} of {v['total_bytes']:>16} bytes free  {v['path']}")
        return 0

    def rename(self) -> int:
        """Move or rename a file or a folder."""
        given = {"path": self._arguments.remote, "target": self._arguments.target}
        return self._either("MOVE_FILE", "RENAME_DIRECTORY", **given)

    def remove(self) -> int:
        """Remove a file or an empty folder."""
        return self._either("DELETE_FILE", "DELETE_DIRECTORY", path=self._arguments.remote)

    def make_folder(self) -> int:
        """Create a folder."""
        return self._tell_daemon("CREATE_DIRECTORY", path=self._arguments.remote)

    def _either(self, of_file: str, of_folder: str, **given: str) -> int:
        with self._connected()() as delivery:
            try:
                delivery.ask(of_file, **given)
            except RefusedError as error:
                if error.error != NOT_FOUND:
                    raise
                delivery.ask(of_folder, **given)
        return 0

    def _tell_daemon(self, name: str, **given: str) -> int:
        with self._connected()() as delivery:
            delivery.ask(name, **given)
        return 0

    def _run(self, transfer: ResumableTransfer) -> int:
        connect = self._connected(Wanted(self._records, transfer))
        try:
            size = carry_on(
                connect, transfer.run, self._until_s, self._arguments.wait, self._progress
            )
        except (GroundError, KeyboardInterrupt) as error:
            if isinstance(error, SpoiledError) or not transfer.is_worth_keeping:
                self._discard(transfer)
            elif self._records.holds(transfer.record):
                text = f"continue with `ground file resume {transfer.record.id}`"
                print(f"ground: {text}", file=sys.stderr)
            raise
        record = transfer.record
        arrow = f"{record.remote} -> {record.local}"
        if record.direction == "put":
            arrow = f"{record.local} -> {record.remote}"
        print(f"{arrow}: {size} bytes")
        return 0

    def _discard(self, transfer: ResumableTransfer) -> None:
        try:
            with self._connected()() as delivery:
                transfer.discard(delivery)
        except GroundError:
            transfer.discard(None)

    def _connected(self, wanted: Callable[[], bool] = lambda: True) -> Connect:
        @contextmanager
        def connected() -> Iterator[Delivery]:
            link = self._make_link()
            try:
                yield Delivery(
                    link,
                    self._catalogue,
                    self._decoder,
                    self._arguments.timeout,
                    self._progress,
                    number=self._numbers.take,
                    is_wanted=wanted,
                )
            finally:
                link.close()

        return connected


class Wanted:
    """Reports whether a transfer is still wanted: `ground file cancel` removes its record."""

    def __init__(self, records: Records, transfer: ResumableTransfer) -> None:
        self._records, self._transfer = records, transfer
        self._looked_s = 0.0

    def __call__(self) -> bool:
        """Return whether the record exists; check this at most five times a second."""
        now_s = time.monotonic()
        if now_s - self._looked_s < 0.2:
            return True
        self._looked_s = now_s
        return self._records.holds(self._transfer.record)


class ProgressLines:
    """Progress on stderr: one line that is rewritten on a terminal, else a line every `EVERY_S`."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def __call__(self, text: str) -> None:
        """Show a text; if stderr is not a terminal, at most one every `EVERY_S`."""
        now_s = time.monotonic()
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
        elif now_s >= self._next_s:
            self._next_s = now_s + EVERY_S
            print(f"ground: {text}", file=sys.stderr, flush=True)
