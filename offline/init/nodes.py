"""The CANopen nodes of a robot, from EDS or DCF files or from a bus.yml of ros2_canopen."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError

from fsw.config.text import explain, read_yaml
from fsw.drivers.layout.files import VALID, read_node
from fsw.drivers.layout.signals import Message
from fsw.errors import ConfigError

BUS_FILES = (".yml", ".yaml")
PARAMETERS, MAPPINGS = 0x1800, 0x1A00  # objects of TPDO 1
PREDEFINED = 4  # TPDOs whose identifiers follow from the node
POSITION_OBJECT = "0x6064"


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One drive; its messages by the names of its TPDOs."""

    node_id: int
    file: Path
    messages: Mapping[str, Message]
    is_mapped: bool = False  # by a bus.yml, not by its file


class _Entry(BaseModel):
    """One mapped object."""

    index: Annotated[int, Field(ge=1, le=0xFFFF)]
    sub_index: Annotated[int, Field(ge=0, le=0xFF)] = 0


class _Tpdo(BaseModel):
    """What the master writes into one TPDO."""

    enabled: bool = True
    cob_id: int | Literal["auto"] = "auto"
    mapping: Annotated[list[_Entry], Field(max_length=64)] | None = None


class _Drive(BaseModel):
    """A node of a bus.yml, with the defaults of the file."""

    node_id: Annotated[int, Field(ge=1, le=127)]
    dcf: str
    tpdo: dict[Annotated[int, Field(ge=1, le=512)], _Tpdo] = {}
    scale_pos_from_dev: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class _Master(BaseModel):
    sync_period: Annotated[int, Field(ge=0)] = 0  # [us]


class _BusFile(BaseModel):
    """What is read of a bus.yml; other keys are ignored."""

    master: _Master = _Master()
    nodes: dict[str, _Drive]


def nodes_of(
    files: Sequence[Path], joints: Sequence[str], ids: Sequence[int]
) -> tuple[list[Node], float]:
    """Return the nodes in the order of the joints, and the rate of SYNC [Hz], 0: not known.

    Parameters
    ----------
    files : one EDS or DCF for all joints, one for each, or a bus.yml
    ids : numbers of the nodes, where the file does not say them

    Raises
    ------
    ConfigError in one line when a file cannot be used.
    """
    if files[0].suffix.lower() in BUS_FILES:
        return _of_bus_file(files[0], joints)
    if len(files) not in (1, len(joints)):
        raise ConfigError(f"{len(files)} files; must be 1, or {len(joints)}, one for each joint")
    each = files if len(files) > 1 else [files[0]] * len(joints)
    found = zip(each, ids, strict=False)
    return [Node(node_id=k, file=file, messages=read_node(file, k)) for file, k in found], 0.0


def _of_bus_file(path: Path, joints: Sequence[str]) -> tuple[list[Node], float]:
    """Return the nodes of a bus.yml, by the joints' names or else in its order."""
    try:
        data = read_yaml(path.read_bytes(), aliases=True)
        bus = _BusFile.model_validate(_with_defaults(data))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise ConfigError(f"{path}: {explain(_BusFile, error)[0]}") from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    is_named = set(joints) <= set(bus.nodes)
    names = list(joints) if is_named else list(bus.nodes)[: len(joints)]
    if len(names) < len(joints):
        raise ConfigError(f"{path}: nodes: {len(names)}; the robot has {len(joints)} joints")
    period_us = bus.master.sync_period
    nodes = [_node(path, name, bus.nodes[name]) for name in names]
    return nodes, 1e6 / period_us if period_us else 0.0


def _with_defaults(data: object) -> object:
    """Return the content of a bus.yml whose nodes have the defaults of the file."""
    if not isinstance(data, dict) or not isinstance(data.get("nodes"), dict):
        return data
    defaults = data.get("defaults")
    own: dict[str, Any] = defaults if isinstance(defaults, dict) else {}
    nodes = {k: own | each if isinstance(each, dict) else each for k, each in data["nodes"].items()}
    return data | {"nodes": nodes}


def _node(path: Path, name: str, drive: _Drive) -> Node:
    file = path.parent / Path(drive.dcf).name
    messages = {
        key: replace(_scaled(message, drive.scale_pos_from_dev), name=f"{name}_{key}")
        for key, message in read_node(file, drive.node_id, dict(_written(drive))).items()
    }
    return Node(node_id=drive.node_id, file=file, messages=messages, is_mapped=True)


def _written(drive: _Drive) -> Iterator[tuple[tuple[int, int], int]]:
    """Yield the objects of its PDOs that a master writes into a drive."""
    for number, own in drive.tpdo.items():
        word = own.cob_id
        if word == "auto" and number <= PREDEFINED:
            word = 0x80 + 0x100 * number + drive.node_id
        if word != "auto":
            yield (PARAMETERS + number - 1, 1), word | (0 if own.enabled else VALID)
        if own.mapping is not None:
            yield (MAPPINGS + number - 1, 0), len(own.mapping)
            for k, entry in enumerate(own.mapping, start=1):
                yield (MAPPINGS + number - 1, k), entry.index << 16 | entry.sub_index << 8


def _scaled(message: Message, scale: float | None) -> Message:
    """Return a message whose position is in radians."""
    if scale is None:
        return message
    return replace(
        message,
        signals=tuple(
            replace(own, scale=scale, unit="rad") if own.name == POSITION_OBJECT else own
            for own in message.signals
        ),
    )
