"""The frames of a bus that a node accepts."""

from hil.devices.canopen import NMT_ID, SDO_ID, SYNC_ID

HeardFrame = tuple[int, int, bytes]  # kernel stamp [ns, CLOCK_REALTIME], identifier, data
HEARD = (SYNC_ID, 0x7FF), (NMT_ID, 0x7FF), (SDO_ID, SDO_ID)  # identifier, mask


def is_heard(can_id: int) -> bool:
    """Return whether a node accepts frames of this identifier."""
    return any(can_id & mask == heard for heard, mask in HEARD)
