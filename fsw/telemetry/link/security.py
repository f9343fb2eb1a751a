"""Both directions of the authenticated link: keys, roles and frame numbers."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from fsw.config import Config
from fsw.config.sdls import SdlsConfig
from fsw.telemetry.link.rescue import Rescue
from fsw.telemetry.link.sdls import Association, FrameReceiver, Role
from fsw.telemetry.link.sdls_keys import load_associations
from fsw.telemetry.link.sdls_numbers import NUMBERS_NAME, NumberStore
from fsw.telemetry.link.sdls_sender import FrameSender

QUIET_NS = 1_000_000_000  # time without a frame after which the exact numbers are stored


class Security:
    """Receiver of telecommand frames and sender of telemetry frames.

    Parameters
    ----------
    state : folder with the file of used numbers
    environment : environment variables, which name the folder of systemd credentials
    report : reports an event; its arguments are code and text
    unix_s : returns the time of day [s]

    Raises
    ------
    ConfigError when keys or stored numbers cannot be used; the caller must then open no link.
    """

    def __init__(
        self,
        config: Config,
        sdls: SdlsConfig,
        state: Path,
        environment: Mapping[str, str],
        report: Callable[[str, str], None],
        unix_s: Callable[[], float],
    ) -> None:
        self._config, self._sdls, self._environment = config, sdls, environment
        self._report = report
        self._numbers = NumberStore(state / NUMBERS_NAME)
        associations = load_associations(config, sdls, environment)
        self.receiver = FrameReceiver(
            _uplink(associations),
            self._numbers,
            spacecraft_id=sdls.spacecraft_id,
            virtual_channel=sdls.virtual_channel,
            window=sdls.window,
            names_spacecraft=sdls.authenticate_spacecraft,
            rescues=Rescue(),
        )
        self.sender: FrameSender | None = None
        for association in _downlink(associations):
            self.sender = FrameSender(
                association,
                self._numbers,
                spacecraft_id=sdls.spacecraft_id,
                virtual_channel=sdls.virtual_channel,
                report=report,
                unix_s=unix_s,
                names_spacecraft=sdls.authenticate_spacecraft,
            )
        self._seen = 0
        self._quiet_ns = 0

    def open(self) -> None:
        """Make room on the disk for the numbers; report a failure, which later writes repeat."""
        try:
            self._numbers.prepare()
        except OSError as error:
            self._report("TC_NOT_KEPT", f"no room for frame numbers: {error.strerror or error}")

    def seal(self, packet: bytes) -> bytes:
        """Return the frame of a telemetry packet; without a telemetry key the packet itself."""
        return packet if self.sender is None else self.sender.seal(packet)

    def load_keys(self) -> None:
        """Read all keys again and use them. Raises ConfigError; the old keys then stay in use."""
        associations = load_associations(self._config, self._sdls, self._environment)
        self.receiver.use(_uplink(associations))
        for association in _downlink(associations):
            if self.sender is not None:
                self.sender.use(association)
        words = ", ".join(f"SPI {item.spi} {item.role}" for item in associations)
        self._report("KEYS_LOADED", words)

    def poll(self, now_ns: int) -> None:
        """Store the exact frame numbers once no frame was accepted for `QUIET_NS`."""
        if self.receiver.accepted != self._seen:
            self._seen, self._quiet_ns = self.receiver.accepted, now_ns
        elif self._quiet_ns and now_ns - self._quiet_ns >= QUIET_NS:
            self._quiet_ns = 0
            with suppress(OSError):  # the stored numbers stay ahead: no frame is accepted twice
                self.receiver.settle()

    def close(self) -> None:
        """Store the last used frame numbers, so that the next start skips none."""
        with suppress(OSError):
            self.receiver.settle()
            if self.sender is not None:
                self.sender.settle()


def _uplink(associations: Sequence[Association]) -> list[Association]:
    return [item for item in associations if item.role is not Role.TELEMETRY]


def _downlink(associations: Sequence[Association]) -> list[Association]:
    return [item for item in associations if item.role is Role.TELEMETRY]
