"""The health word: one bit per fault, latched until cleared; 0 is healthy."""

from fsw.telemetry.dictionary.codes import Health

# events that set a bit
SET_BY = {
    "PORT_LOST": Health.PORT_LOST,
    "ESTIMATOR_RESET": Health.ESTIMATOR_RESET,
    "NOISE_ABOVE_DECLARED": Health.MODEL_MISMATCH,
    "PRIOR_CONFLICT": Health.MODEL_MISMATCH,
    "SENSOR_CREEPS": Health.MODEL_MISMATCH,
    "RECORDER_FAILED": Health.RECORDER,
    "DISK_FULL": Health.RECORDER,
    "BLOCKS_FAILED": Health.RECORDER,
    "RING_DROPS": Health.RING_DROPS,
    "ESTIMATION_DROPS": Health.RING_DROPS,
    "ESTIMATION_LOST": Health.ESTIMATION,
    "BATCH_FAILED": Health.BATCH_FAILED,
    "TABLE_CORRUPT": Health.TABLE,
    "PARAMETERS_CORRUPT": Health.PARAMETER_STORE,
    "STATE_REFUSED": Health.STATE,
    "CHECKPOINT_REFUSED": Health.STATE,
    "CHECKPOINT_FAILED": Health.STATE,
    "STATE_REMOVED": Health.STATE,
    "STATE_TAKEN": Health.STATE,
    "BUS_SWITCHED": Health.BUS,
    "LIMIT_VIOLATED": Health.LIMIT,
    "COMMAND_LOSS": Health.COMMAND_LOSS,
    "LOOP_SILENT": Health.LOOP_SILENT,
    "LINK_FAILED": Health.LINK,
    "CONTROL_FAILED": Health.LINK,
    "SERVICE_LOST": Health.SERVICE,
    "SERVICE_MEMORY": Health.SERVICE,
    "TC_AUTH_FAILED": Health.SECURITY,
    "TC_NOT_AUTHORISED": Health.SECURITY,
    "TC_NOT_KEPT": Health.SECURITY,
    "TM_NUMBERS_FAILED": Health.SECURITY,
}


class HealthWord:
    """One bit for each kind of fault.

    `latched` holds the faults that have occurred since they were last cleared. `now` holds the
    faults that are present. A fault reported only by an event is in `latched`, never in `now`.
    """

    def __init__(self) -> None:
        self.latched = 0
        self._standing = 0

    @property
    def now(self) -> int:
        """Return the bits of the faults that are present."""
        return self._standing

    def event(self, code: str) -> int:
        """Apply an event to the health word; return the newly latched bits."""
        bit = SET_BY.get(code)
        return 0 if bit is None else self.set(bit)

    def set(self, bit: Health) -> int:
        """Latch a bit; return its mask if it was not latched before, otherwise 0."""
        mask = 1 << bit
        new = mask & ~self.latched
        self.latched |= mask
        return new

    def standing(self, bit: Health, present: bool) -> int:
        """Record whether a fault is present; return its mask if newly latched, otherwise 0."""
        mask = 1 << bit
        if not present:
            self._standing &= ~mask
            return 0
        self._standing |= mask
        return self.set(bit)

    def clear(self, mask: int) -> None:
        """Clear the latched bits of a mask; the bit of a fault that is still present stays set."""
        self.latched &= ~mask | self._standing
