"""Worst-case load of buses and lines, and delay of every sensor, at the configured rates.

The functions need no device. Lengths of frames are those of docs/icd.md and of the codecs.
"""

from fsw.config import (
    Actuator,
    BusConfig,
    Config,
    ImuConfig,
    SchedulerConfig,
    StarTrackerConfig,
)
from fsw.config.feed import SAMPLES
from fsw.drivers.codecs.entries import imu_codec, star_tracker_codec
from fsw.drivers.ports.stamps import KERNEL_WAIT_NS

BITS_PER_BYTE = 10  # 8N1: start, eight data, stop
ASSUMED_BITRATE = 1_000_000  # for a bus whose bit rate is not set in the configuration
ASSUMED_DATA_BITRATE = 5_000_000
SYNC_BYTES = 1
TPDO1_BYTES = 8
TPDO1_FD_BYTES = 20
TPDO2_BYTES = 8
ACTUATOR_TPDO2_BYTES = 2
TPDO2_DIVIDER = 10  # a node sends TPDO2 at every tenth SYNC


def classic_frame_s(data_bytes: int, bitrate: float) -> float:
    """Return the longest duration [s] of a classic base frame, including the interframe space.

    Source: CAN 2.0 frame layout: 47 + 8 n bits, of which 34 + 8 n get a stuff bit every fourth.
    """
    stuffed = 34 + 8 * data_bytes
    return (47 + 8 * data_bytes + (stuffed - 1) // 4) / bitrate


def fd_frame_s(data_bytes: int, bitrate: float, data_bitrate: float) -> float:
    """Return the longest duration [s] of an ISO CAN FD base frame with bit-rate switch.

    Arbitration phase: 17 bits up to BRS and 4 stuff bits; 13 bits from CRC delimiter to interframe
    space. Data phase: ESI, DLC and data with a stuff bit after every fourth bit, stuff count, CRC
    with fixed stuff bits. Source: ISO 11898-1:2015.
    """
    crc_bits = 17 if data_bytes <= 16 else 21
    body = 5 + 8 * data_bytes
    fixed_stuff = (4 + crc_bits) // 4 + 1
    data_bits = body + body // 4 + 4 + crc_bits + fixed_stuff
    return (17 + 4 + 13) / bitrate + data_bits / data_bitrate


def bus_load(config: Config, bus: BusConfig) -> float:
    """Return the worst-case load of a bus by SYNC, TPDO1 and TPDO2 (1: full)."""
    if bus.interface == SAMPLES:
        return 0.0
    bitrate = bus.bitrate or ASSUMED_BITRATE
    data_bitrate = bus.data_bitrate or ASSUMED_DATA_BITRATE
    cycle_s = classic_frame_s(SYNC_BYTES, bitrate)
    for joint in config.joints:
        if joint.bus != bus.name or joint.driver == "described":  # no rate of its frames is known
            continue
        if joint.format == "fd":
            cycle_s += fd_frame_s(TPDO1_FD_BYTES, bitrate, data_bitrate)
        else:
            cycle_s += classic_frame_s(TPDO1_BYTES, bitrate)
            cycle_s += classic_frame_s(TPDO2_BYTES, bitrate) / TPDO2_DIVIDER
    report_s = classic_frame_s(TPDO1_BYTES, bitrate)
    report_s += classic_frame_s(ACTUATOR_TPDO2_BYTES, bitrate) / TPDO2_DIVIDER
    reports_hz = sum(
        {
            other.node_id: other.rate_hz
            for own in config.actuators.values()
            for other in own
            if other.bus == bus.name and other.driver == "canopen"
        }.values()
    )
    return cycle_s * bus.rate_hz + report_s * reports_hz


def imu_load(imu: ImuConfig) -> tuple[float, float]:
    """Return the load of the line (1: full) by the shortest and by the longest datagrams."""
    shortest, longest = imu_codec(imu).frame_bytes if imu.is_serial else (0, 0)
    bytes_per_s = imu.baud_rate / BITS_PER_BYTE
    return shortest * imu.rate_hz / bytes_per_s, longest * imu.rate_hz / bytes_per_s


def star_tracker_load(tracker: StarTrackerConfig) -> float:
    """Return the worst-case load of the star tracker's line (1: full)."""
    longest = star_tracker_codec(tracker).frame_bytes[1] if tracker.is_serial else 0
    return longest * BITS_PER_BYTE * tracker.rate_hz / tracker.baud_rate


def joint_delay_s(bus: BusConfig, scheduler: SchedulerConfig) -> float:
    """Return the longest delay [s] from latch to reading: latch offset, cycle, kernel, tick."""
    waits_s = KERNEL_WAIT_NS * 1e-9 + 1.0 / scheduler.tick_rate_hz
    return abs(bus.latch_offset_s) + 1.0 / bus.rate_hz + waits_s


def actuator_delay_s(own: Actuator, config: Config) -> float:
    """Return the longest delay [s] from validity to reading; without a bus: late_s and a tick."""
    buses = [bus for bus in config.buses if bus.name == own.bus]
    waits_s = [joint_delay_s(bus, config.scheduler) for bus in buses]
    return own.late_s + (waits_s or [1.0 / config.scheduler.tick_rate_hz])[0]


def imu_delay_s(imu: ImuConfig, scheduler: SchedulerConfig) -> float:
    """Return the longest delay [s] from validity to reading: group delay, sample, line, tick."""
    group_s = max(imu.gyro_group_delay_s, imu.acc_group_delay_s)
    line_s = imu_load(imu.model_copy(update={"crlf": True}))[1] / imu.rate_hz  # the longest
    return group_s + 1.0 / imu.rate_hz + line_s + 1.0 / scheduler.tick_rate_hz


def star_tracker_delay_s(tracker: StarTrackerConfig, scheduler: SchedulerConfig) -> float:
    """Return the longest delay [s] from mid-exposure to reading: latency, line, tick."""
    line_s = star_tracker_load(tracker) / tracker.rate_hz
    return tracker.latency_s + line_s + 1.0 / scheduler.tick_rate_hz
