"""Service 15: packet stores and their retrieval by time range.

Three circular stores hold events with monitor transitions, housekeeping, and science. This
storage-control configuration (15,3 to 15,6) is fixed. Answers, logs and files are not stored, for
they can be requested again; nor are verification reports, for a repeated one could be mistaken for
that of a newer telecommand. A retrieval sends the stored packets unchanged, at low priority, and at
most as fast as the fastest client reads them.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, APID_SCIENCE, Error, Store
from fsw.telemetry.link.packets import HEADER_BYTES, TM_HEADER_BYTES, from_cuc
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.services.ground_link import GroundLink
from fsw.telemetry.state.documents import keep_document, read_document
from fsw.telemetry.state.packet_store import PacketStore
from fsw.telemetry.state.store import GenerationStore

FOLDER, SWITCHES = "packet_stores", "packet_store_switches"
LOOKED_AT_PER_POLL = 500  # stored packets read, of all retrievals together
SENT_PER_POLL = 64
RETRY_NS = 10_000_000_000  # time without writing after a packet could not be stored
EVENT_SERVICE = 5
TRANSITION = (12, 12)
HOUSEKEEPING = (3, 25)


@dataclass(slots=True)
class _Retrieval:
    request: Request
    packets: Iterator[bytes | None]
    sent: int = 0
    held: bytes = b""  # the next packet to send; empty: none


def store_of(packet: bytes) -> Store | None:
    """Return the store a packet belongs to; None if the packet is not stored."""
    apid = int.from_bytes(packet[:2], "big") & 0x7FF
    if len(packet) < TM_HEADER_BYTES or not packet[0] & 0x08:
        return None
    kind = packet[HEADER_BYTES + 1], packet[HEADER_BYTES + 2]
    if apid == APID_SCIENCE:
        return Store.SCIENCE
    if apid != APID_ESTIMATOR:
        return None
    if kind == HOUSEKEEPING:
        return Store.HOUSEKEEPING
    return Store.EVENTS if kind[0] == EVENT_SERVICE or kind == TRANSITION else None


class Playback:
    """Stores packets of events, housekeeping and science, and sends them again on request."""

    def __init__(self, context: TelemetryContext, link: GroundLink) -> None:
        self._context, self._link = context, link
        sizes = context.telemetry.packet_stores
        limits_bytes = {
            Store.EVENTS: sizes.events_bytes,
            Store.HOUSEKEEPING: sizes.housekeeping_bytes,
            Store.SCIENCE: sizes.science_bytes,
        }
        folder = context.state / FOLDER
        self._stores = {
            store: PacketStore(
                folder / store.name.lower(),
                limits_bytes[store],
                context.epoch,
                reserve_bytes=context.reserve_bytes,
            )
            for store in Store
        }
        self._switches = GenerationStore(context.state / SWITCHES)
        found, _ = read_document(self._switches, _parse)
        self._disabled: frozenset[Store] = found if found is not None else frozenset()
        self._retrievals: dict[Store, _Retrieval] = {}
        self._failed = dict.fromkeys(Store, 0)
        self._retry_ns: dict[Store, int] = {}

    def keep(self, packet: bytes) -> None:
        """Store a sent packet, if it belongs to an enabled store."""
        store = store_of(packet)
        if store is None or store in self._disabled:
            return
        if self._context.now_ns() < self._retry_ns.get(store, 0):
            self._failed[store] += 1
            return
        was_failing = store in self._retry_ns
        try:
            self._stores[store].append(packet)
        except (OSError, ValueError) as error:
            self._failed[store] += 1
            self._retry_ns[store] = self._context.now_ns() + RETRY_NS
            if not was_failing:
                self._context.report("PACKET_STORE_FAILED", f"{store.name}: {error}")
            return
        if was_failing:
            del self._retry_ns[store]
            self._context.report("PACKET_STORE_BACK", store.name)

    def files(self) -> list[Path]:
        """Return the paths of the files that grow: the newest segment of each store."""
        newest = (store.newest for store in self._stores.values())
        return [path for path in newest if path is not None]

    def poll(self) -> None:
        """Send the next packets of every retrieval, as far as the link has room."""
        looks, sends = LOOKED_AT_PER_POLL, SENT_PER_POLL
        room_bytes = self._link.room_bytes if self._retrievals else 0
        for store, retrieval in list(self._retrievals.items()):
            while looks and sends and (not retrieval.held or len(retrieval.held) <= room_bytes):
                if retrieval.held:
                    self._context.down.again(retrieval.held)
                    room_bytes -= len(retrieval.held)
                    sends -= 1
                    retrieval.sent += 1
                    retrieval.held = b""
                looks -= 1
                try:
                    retrieval.held = next(retrieval.packets) or b""
                except StopIteration:
                    self._end(store, None)
                    break

    def digest(self) -> list[object]:
        """Return all state that telecommands can change, as plain values."""
        return [sorted(self._disabled), sorted(self._retrievals)]

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "ENABLE_STORE": partial(self._switch, enabled=True),
            "DISABLE_STORE": partial(self._switch, enabled=False),
            "PLAY_BACK": self._play_back,
            "DELETE_STORED": self._delete,
            "REPORT_STORE_CONTENT": self._report_content,
            "ABORT_PLAYBACK": self._abort,
            "REPORT_STORE_STATUS": lambda _: self._report_status,
        }

    def _switch(self, request: Request, *, enabled: bool) -> Action:
        store = Store(request.whole("store"))
        disabled = self._disabled - {store} if enabled else self._disabled | {store}

        def act() -> Done:
            keep_document(self._switches, {"disabled": sorted(item.name for item in disabled)})
            self._disabled = frozenset(disabled)
            return Done.NOW

        return act

    def _play_back(self, request: Request) -> Action:
        store = Store(request.whole("store"))
        from_ns, to_ns = _time_ns(request, "from"), _time_ns(request, "to")
        if from_ns > to_ns:
            raise TcError(Error.OUT_OF_RANGE, 6, to_ns * 1e-9, "the range ends before it begins")
        if store in self._retrievals:
            raise TcError(Error.BUSY, 2, store, "a retrieval from it is under way")

        def act() -> Done:
            found = self._stores[store].packets(from_ns or None, to_ns)
            self._retrievals[store] = _Retrieval(request, found)
            self._context.report("PLAYBACK_STARTED", store.name)
            return Done.LATER

        return act

    def _abort(self, request: Request) -> Action:
        store = Store(request.whole("store"))
        if store not in self._retrievals:
            raise TcError(Error.NOT_STAGED, 2, store, "no retrieval is under way")

        def act() -> Done:
            self._end(store, TcError(Error.FAILED, text="aborted by ABORT_PLAYBACK"))
            return Done.NOW

        return act

    def _end(self, store: Store, error: TcError | None) -> None:
        retrieval = self._retrievals.pop(store)
        text = f"{store.name}: {retrieval.sent} packets" + (f", {error}" if error else "")
        self._context.report("PLAYBACK_ENDED", text)
        self._context.executor.finish(retrieval.request, error)

    def _delete(self, request: Request) -> Action:
        store, until_ns = Store(request.whole("store")), _time_ns(request, "until")
        if store in self._retrievals:
            raise TcError(Error.BUSY, 5, store, "a retrieval from it is under way")

        def act() -> Done:
            try:
                self._stores[store].delete_until(until_ns)
            except OSError as error:
                raise TcError(Error.FAILED, text=error.strerror or str(error)) from error
            return Done.NOW

        return act

    def _report_content(self, request: Request) -> Action:
        store = Store(request.whole("store"))

        def act() -> Done:
            held = self._stores[store]
            oldest_ns, newest_ns = held.span() or (0, 0)
            values = {
                "n": 1,
                "store": int(store),
                "oldest_s": oldest_ns / 1e9,
                "newest_s": newest_ns / 1e9,
                "filled_percent": 100 * held.size_bytes // held.limit_bytes,
                "stored_bytes": held.size_bytes,
                "size_bytes": held.limit_bytes,
            }
            self._context.down.send("store_content", values)
            return Done.NOW

        return act

    def _report_status(self) -> Done:
        for store in Store:
            values = {
                "n": 1,
                "store": int(store),
                "enabled": store not in self._disabled,
                "playing_back": store in self._retrievals,
                "failed": self._failed[store],
            }
            self._context.down.send("store_status", values)
        return Done.NOW


def _time_ns(request: Request, name: str) -> int:
    """Return the mission elapsed time in the arguments that begin with `name` [ns]."""
    fine = request.whole(f"{name}_fine")
    coarse_s, p_field = request.whole(f"{name}_coarse_s"), request.whole(f"{name}_p_field")
    return from_cuc(struct.pack(">BIBH", p_field, coarse_s, fine >> 16, fine & 0xFFFF))


def _parse(document: Any) -> frozenset[Store]:  # noqa: ANN401
    """Return the disabled stores in a document."""
    return frozenset(Store[name] for name in document["disabled"])
