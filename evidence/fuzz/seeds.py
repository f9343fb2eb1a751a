"""First inputs of the targets: correct inputs, so that coverage begins after the check values."""

import json
import tempfile
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import msgpack
import numpy as np

from evidence.fuzz.delivery_target import ANY, DATA, END, METADATA
from evidence.fuzz.description_target import KINDS
from evidence.fuzz.hostile import PATHS, ROBOT_EDITS, TEXTS
from evidence.fuzz.oracle import ENDS_CHUNK, SEALED
from evidence.fuzz.text_targets import CORRECT
from fsw.drivers.wire import ByteChunk, CanFrame, frame_array, pack_frame
from fsw.exchange.checkpoint import Checkpoint, Identity, encode
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import CanTraffic, SerialTraffic
from fsw.messages import Snapshot
from fsw.messages.commands import CommandName
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.state.epoch import Epoch
from fsw.telemetry.state.packet_store import PacketStore
from hil.devices import sagitta as sagitta_device

# docs/icd.md section 2, without the CRC, which sealing adds
STIM_VECTOR = bytes.fromhex(
    "a5004000008000ff40000000cccdfe666600666600190019801a0000180018801900002a04d2"
)
DESCRIPTIONS = (
    (
        ".dbc",
        b'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 9 E: 8 A\n SG_ M M : 0|8@1+ (1,0) [0|0] "" A\n'
        b' SG_ p m1 : 15|16@0- (0.1,-3) [0|0] "deg" A\n SG_ f m2 : 32|32@1- (1,0) [0|0] "" A\n'
        b"SIG_VALTYPE_ 9 f : 1;\n",
    ),
    (
        ".kcd",
        b'<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/><Bus name="a">'
        b'<Message id="0x9" name="E" length="8"><Signal name="p" offset="3" length="13">'
        b'<Value type="signed" slope="0.5"/></Signal></Message></Bus></NetworkDefinition>',
    ),
    (
        ".sym",
        b'FormatVersion=6.0 // a\nTitle="a"\n{SIGNALS}\nSig=p signed 16 /f:0.1\n{SENDRECEIVE}\n'
        b"[E]\nID=009h\nLen=8\nSig=p 0\n",
    ),
    (
        ".arxml",
        b'<?xml version="1.0"?><AUTOSAR xmlns="http://autosar.org/schema/r4.0"><AR-PACKAGES>'
        b"<AR-PACKAGE><SHORT-NAME>a</SHORT-NAME><ELEMENTS/></AR-PACKAGE></AR-PACKAGES></AUTOSAR>",
    ),
    *(
        (
            kind,
            b"[6064]\nParameterName=p\nObjectType=7\nDataType=4\nAccessType=rw\n"
            b"[1800]\nParameterName=c\nObjectType=9\nSubNumber=2\n[1800sub0]\nParameterName=n\n"
            b"DataType=5\nAccessType=ro\nDefaultValue=1\n[1800sub1]\nParameterName=i\nDataType=7\n"
            b"AccessType=rw\nDefaultValue=$NODEID+0x180\n[1A00]\nParameterName=m\nObjectType=9\n"
            b"SubNumber=2\n[1A00sub0]\nParameterName=n\nDataType=5\nAccessType=rw\n"
            b"DefaultValue=1\n[1A00sub1]\nParameterName=e\nDataType=7\nAccessType=rw\n"
            b"DefaultValue=0x60640020\n",
        )
        for kind in (".eds", ".dcf")
    ),
    (
        "keys",
        b"[{name: m, id: 9, length: 8, signals: [{name: p, start: 15, bits: 16, order: big, "
        b"range: [-3, 3]}, {name: t, start: 24, bits: 12, number: signed, scale: 0.1}]}]",
    ),
    (
        "keys",
        b"[{name: m, id: 9, extended: true, length: 12, signals: [{name: p, start: 0, bits: 32, "
        b"number: float, invalid: 7}, {name: x, start: 40, bits: 3}, {name: t, start: 64, "
        b"bits: 16, multiplexer: x, pages: [1]}]}]",
    ),
)


def segment(op: int, payload: bytes) -> bytes:
    """Return one segment of an input."""
    return bytes((op, len(payload))) + payload


def seeds(name: str) -> list[bytes]:
    """Return the first inputs of a target. Raises KeyError for an unknown name."""
    makers: dict[str, Callable[[], list[bytes]]] = {
        "canopen": _frames,
        "recorded_frame": _recorded,
        "stim300": lambda: _serial(STIM_VECTOR),
        "mip": lambda: _serial(_mip()),
        "sagitta": lambda: _serial(_solution()),
        "feed": _feeds,
        "description": lambda: [bytes((KINDS.index(kind),)) + text for kind, text in DESCRIPTIONS],
        "command": _commands,
        "config": lambda: [
            CORRECT,
            b"+recorder: {directory: r, part_bytes: null}\n",
            b"+a: [&x *x]",
        ],
        "checkpoint": _checkpoints,
        "recording": _recordings,
        "state": _states,
        "tc_packet": _telecommands,
        "tc_frame": lambda: [segment(SEALED | ENDS_CHUNK, b"\0" + bytes(20)) * 3],
        "file_unit": _deliveries,
        "operations": _operations,
    }
    return makers[name]() if name in makers else _serial(_published(name))


def _operations() -> list[bytes]:
    """Return uploads of hostile tables and robots, a line, file commands on a link, and others."""
    uploads = [bytes((0, table, 3, k)) for table in (1, 2, 3) for k in range(len(TEXTS))]
    robots = [bytes((0, 0, 0, 1, k, 0)) for k in range(len(ROBOT_EDITS))]
    links = bytes((2, 1, 1))
    named = [k for k, item in enumerate(DICTIONARY.telecommands) if item.service == 23]
    on_links = [links + bytes((5, k, PATHS.index("files/loop"))) for k in named]
    others = [bytes((5, k)) for k in range(len(DICTIONARY.telecommands))]
    return [*uploads, *robots, b"\x01", *on_links, *others]


def _feeds() -> list[bytes]:
    """Return datagrams of every kind in order, repeated, of a jump in time, as JSON, damaged."""
    good = [bytes((kind, k, 100 + 4 * k, 101 + 4 * k)) for k in range(6) for kind in range(3)]
    sent = [segment(SEALED | ENDS_CHUNK, payload) for payload in good]
    times = ', "t_valid_ns": 1, "t_sent_ns": 2, "values": [0.1, null]}'
    text = '{"source": 7, "sequence": 1, "kind": "joints", "clock": "monotonic"' + times
    damaged = segment(ENDS_CHUNK, b"FSW1" + bytes(40))
    jumped = segment(SEALED | ENDS_CHUNK, bytes((0, 200, 128, 255)))
    return [
        b"".join(sent),
        sent[0] * 3 + sent[3] + sent[0],
        jumped + b"".join(sent[3:]),
        segment(ENDS_CHUNK, text.encode()) * 2 + damaged,
    ]


def _serial(payload: bytes) -> list[bytes]:
    once = segment(SEALED, payload)
    torn = segment(SEALED | ENDS_CHUNK, payload) + segment(ENDS_CHUNK, payload[:9]) + once
    return [once, once * 3, torn, segment(0, payload)]


def _published(name: str) -> bytes:
    """Return the published datagram of a simulated device; nothing for a codec without device."""
    if find_spec(f"hil.devices.{name}") is None:
        return b""
    vector: bytes = import_module(f"hil.devices.{name}").VECTOR
    return vector


def _mip() -> bytes:
    rate = b"\x0e\x05" + bytes(12)
    force = b"\x0e\x04" + bytes(12)
    return b"\x80" + rate + force + b"\x0a\xd5" + (10**9).to_bytes(8, "big")


def _solution() -> bytes:
    return sagitta_device.solution_payload(
        sagitta_device.Solution(q_wxyz=(1.0, 0.0, 0.0, 0.0), unix_us=5_000_000, ticks=9)
    )


def _frames() -> list[bytes]:
    sync = segment(0x11, b"\0\0" + b"\x01")
    pdo = segment(0x11, b"\x01\0" + bytes.fromhex("0712cdff2efb0901"))
    fd = segment(0x15, b"\x02\0" + bytes(12) + b"\x09\0\x01" + bytes(5))
    others = [segment(0x11, bytes((k, 0)) + bytes(8)) for k in (3, 4, 5, 7)]
    return [sync + pdo, sync + fd, (sync + pdo + fd) * 3, b"".join(others)]


def _recorded() -> list[bytes]:
    classic = pack_frame(CanFrame(7, 0x191, bytes(8)))
    fd = pack_frame(CanFrame(7, 0x192, bytes(20), is_fd=True, bitrate_switch=True))
    return [b"\0" + classic, b"\x80" + fd]


def _commands() -> list[bytes]:
    plain = [f'{{"command": "{name}"}}'.encode() for name in CommandName]
    batch = b'{"command": "run-batch", "method": "fused", "unknown": "both", "last_s": 60}'
    return [*plain, batch, b"\n".join(plain)]


def _checkpoints() -> list[bytes]:
    state = {"kind": "online", "after": 3, "x": np.arange(3.0), "n": None, "f": float("inf")}
    snapshot = Snapshot(t_ns=1, grid_ns=2, state=state)
    whole = encode(Checkpoint(identity=Identity(1, 2), sequence=3, boot_id="b", snapshot=snapshot))
    bare: bytes = msgpack.packb({"boot_id": "", "t_ns": 1, "grid_ns": None, "state": {}})
    return [whole, b"+" + whole[34:-4], b"+" + bare]


def _states() -> list[bytes]:
    boot = {"count": 3, "cause": 0, "running": True, "next_cause": 0}
    numbers = {"keys": {"f": {"floor": 17, "retired": False}}}
    documents = (boot, {"gate_probability": 1e-6}, numbers, [1], {"t_ns": 1, "code": "STARTED"})
    epoch = Epoch(clock_id="b", utc_less_met_ns=5)
    with tempfile.TemporaryDirectory() as folder:
        store = PacketStore(Path(folder), 1 << 20, lambda: epoch)
        store.append(bytes(5) + b"\x10" + bytes(7) + b"\x2f" + bytes(9))  # a header with a time
        segments = [path.read_bytes() for path in Path(folder).iterdir()]
    return [*(json.dumps(document).encode() for document in documents), *segments]


def _recordings() -> list[bytes]:
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for compression in ("none", "zstd", "lz4"):
            path = Path(folder) / "a.mcap"
            writer = RecordingWriter(path, compression, 4096)
            writer.attach("a", "text/plain", b"b")
            frames = frame_array(CanFrame(k, 0x191, bytes(8)) for k in range(3))
            writer.traffic(CanTraffic("arm", frames))
            writer.traffic(SerialTraffic("imu", [ByteChunk(2, b"xyz")]))
            writer.end_chunk()
            writer.json("/tc", 4, {"command": "end"})
            writer.sync()
            cut = path.read_bytes()
            writer.close()
            found += [cut, path.read_bytes()]
    return found


def _telecommands() -> list[bytes]:
    found = []
    for telecommand in DICTIONARY.telecommands:
        size = sum(field.size_bytes for field in telecommand.arguments)
        head = b"\x2f" + bytes((telecommand.service, telecommand.subtype)) + b"\0\0"
        number = telecommand.function_id
        body = bytes(size) if number is None else number.to_bytes(2, "big") + bytes(size)
        found.append(segment(SEALED | ENDS_CHUNK, (head + body)[:255]))
    return [*found, segment(SEALED, b"\xff" + bytes(20))]


def _deliveries() -> list[bytes]:
    """Return a whole file, a file in wrong order, answers to a sent file, and a mixture of all."""
    named = bytes((0, 0, 0, 0, 8)) + b"\x05a.bin" + b"\x05b.bin"
    begin, end = segment(SEALED, bytes((METADATA,)) + named), segment(SEALED, bytes((END, 0)))
    data = [segment(SEALED, bytes((DATA, k)) + bytes((k, 1, 2, 3))) for k in range(2)]
    final = segment(SEALED, bytes((ANY,)) + bytes((0x06, 0x51, 0x01)))  # acknowledge FINISHED
    nak = b"\x08" + bytes(4) + (1536).to_bytes(4, "big") + bytes(6) + b"\x01\0"
    answers = [b"\x06\x41\x01", nak, b"\x05\x02"]
    back = b"".join(segment(SEALED, bytes((ANY | 0x10,)) + body) for body in answers)
    whole = begin + data[0] + data[1] + end + final
    return [whole, data[1] + end + begin + data[0] + end + final, back, whole + back + whole]
