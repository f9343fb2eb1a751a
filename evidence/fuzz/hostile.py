"""A grammar of the inputs of an operator or attacker: valid in form, hostile in content.

Telecommands and their arguments come from the dictionary, tables from the schema of the
configuration. Most values are within their bounds, some on a bound, a few far outside.
"""

import json
import re
from collections.abc import Callable
from typing import Any

import yaml

from evidence.fuzz.choices import Choices
from fsw.config.tables import MonitorsTable, NoiseTable, RatesTable
from fsw.messages.commands import PLAN_BOUNDS, CommandName
from fsw.telemetry.dictionary import DICTIONARY, Field, Telecommand, Type
from fsw.telemetry.link.packets import parameters_data, telecommand_packet

NUMBERS = (0.0, -0.0, 1.0, -1.0, 2e-5, 1e-6, 1e-12, 1e-300, 0.1, 80.0, 7e4, 1e10, 1e155, 1e300)
STRANGE: tuple[object, ...] = (
    float("inf"),
    float("-inf"),
    float("nan"),
    True,
    None,
    "",
    "x" * 300,
    [[]],
    {"a": {}},
)
PATHS = (
    "files", "files/a.txt", "files/loop", "files/deep/er", "files/../../etc/passwd", "/etc/passwd",
    "..", ".", "files/.", "recordings", "recordings/..", "events.jsonl", "status.json",
    "files/tables/noise_active.yaml", "files/table", "files//a.txt", "files/" + "x" * 50, "~", "%s",
)  # fmt: skip
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{k}: &{k} [{','.join(['*' + chr(ord(k) - 1)] * 9)}]\n" for k in "bcdefghi"
)
BODY = "com_m: [0, 0, 0], inertia_kg_m2: [6, 0, 0, 5, 0, 4]"
SIGMA = "sigma: {mass_kg: 40, com_m: [0.2, 0.2, 0.2], inertia_kg_m2: [3, 1, 1, 3, 1, 3]}"
TEXTS = (  # tables that have crashed the daemon once
    "joints: {%(joint)s: {position_noise_rad: 2.0e-5}}",
    "joints: {%(joint)s: {position_noise_rad: 1.0e-6, torque_noise_nm: 0.05}}",
    f"bodies: {{target: {{mass_kg: 1.0e-6, {BODY}, {SIGMA}}}}}",
    f"bodies: {{target: {{mass_kg: 80, {BODY.replace('[0,', '[70000,')}, {SIGMA}}}}}",
    f"bodies: {{target: {{mass_kg: 80, {BODY}, {SIGMA.replace('40', '1.0e+10')}}}}}",
    "joints: {%(joint)s: {torque_noise_nm: 1.0e+155}}",
    BOMB,
    "[" * 5000,
    "- " * 3000,
    "sets: {1: {interval_s: " + "9" * 5000 + "}}",
    "sets: {0x" + "f" * 5000 + ": {interval_s: 1.0}}",
    "!!timestamp x",
    "!!float {}",
    "1" + ":59" * 4000 + ".5",
    "? [a]\n: b",
    "\x00",
    "",
)
WATCHED = ("health.slips", "health.nothing", "estimate.nis", "x", "a.b")
ROBOT_EDITS = (
    (r'xyz="[^"]*"', 'xyz="0 0 1e300"'),
    (r'xyz="[^"]*"', 'xyz="nan 0 0"'),
    (r'rpy="[^"]*"', 'rpy="0 inf 0"'),
    (r'mass value="[^"]*"', 'mass value="1e300"'),
    (r'mass value="[^"]*"', 'mass value="-1"'),
    (r'mass value="[^"]*"', 'mass value="0"'),
    (r'mass value="[^"]*"', 'mass value="7.5"'),
    (r'ixx="[^"]*"', 'ixx="-1e-9"'),
    (r'ixx="[^"]*"', 'ixx="1e8"'),
    (r'type="revolute"', 'type="floating"'),
    (r'type="fixed"', 'type="continuous"'),
    (r"<limit[^>]*>", ""),
    (r'parent link="[^"]*"', 'parent link="nolink"'),
    (r'child link="[^"]*"', 'child link="nolink"'),
    (r"</robot>", "".join(f'<link name="l{k}"/>' for k in range(5000)) + "</robot>"),
    (r"</robot>", "<a>" * 5000 + "</a>" * 5000 + "</robot>"),
    (r"<robot", '<!DOCTYPE r [<!ENTITY a "b">]><robot'),
    (r"<robot", '<?xml version="1.0" encoding="utf-16"?><robot'),
    (r"</robot>", ""),
)


class Grammar:
    """Makes hostile telecommands, tables and lines from choices.

    Parameters
    ----------
    joints : names of the robot's joints
    robot : text of the robot's URDF
    without : names of telecommands and commands that are never made
    """

    def __init__(
        self, joints: tuple[str, ...], robot: str, without: frozenset[str] = frozenset()
    ) -> None:
        self._telecommands = [t for t in DICTIONARY.telecommands if t.name not in without]
        self._commands = [str(n) for n in CommandName if n.name not in without | {"STOP"}]
        self._joints, self._robot = joints, robot
        self._schemas = [m.model_json_schema() for m in (NoiseTable, RatesTable, MonitorsTable)]

    def telecommand(self, choices: Choices, sequence: int, depth: int = 0) -> bytes:
        """Return the packet of one telecommand; most of its arguments are within their bounds."""
        item = choices.one(self._telecommands)
        if item.repeats and item.service == 20:
            return self._parameters(item, choices, sequence)
        values = {f.name: self._argument(f, choices, sequence, depth) for f in item.arguments}
        return telecommand_packet(item, values, sequence)

    def _parameters(self, item: Telecommand, choices: Choices, sequence: int) -> bytes:
        parameter = choices.one(DICTIONARY.parameters)
        edges = (parameter.default, parameter.minimum, parameter.maximum)
        data = parameters_data({parameter.id: choices.one(edges)})
        value = choices.raw(9) if choices.once_in(8) else data[3:]
        values = {"count": 1 + choices.number(2), "parameter": parameter.id, "value": value}
        return telecommand_packet(item, values, sequence)

    def _argument(self, field: Field, choices: Choices, sequence: int, depth: int) -> object:
        if field.type is Type.BYTES:
            if choices.once_in(2) or depth > 2:
                return choices.raw(60)
            return self.telecommand(choices, sequence ^ 0x2000, depth + 1) + choices.raw(5)
        if field.type is Type.TEXT:
            return choices.one(PATHS)[: field.size]
        if field.enumeration is not None and not choices.once_in(16):
            return choices.one(list(field.enumeration.labels))
        if field.type.startswith("f"):
            low, high = field.minimum, field.maximum
            edges = [0.0 if low is None else low, 1.0 if high is None else high, *NUMBERS]
            edges += [v for v in STRANGE if isinstance(v, float)] if choices.once_in(8) else []
            value = float(choices.one(edges))
            narrow = field.type is Type.F32 and 3.4e38 < abs(value) < float("inf")
            return 3.4e38 if narrow else value
        return self._whole(field, choices)

    @staticmethod
    def _whole(field: Field, choices: Choices) -> int:
        bits = int(field.type[1:])
        least, most = (-(1 << bits - 1), (1 << bits - 1) - 1)
        if field.type.startswith("u"):
            least, most = 0, (1 << bits) - 1
        low = least if field.minimum is None else int(field.minimum)
        high = most if field.maximum is None else int(field.maximum)
        edges = [low, high, low + 1, (low + high) // 2, min(low + 3, high)]
        if choices.once_in(6):
            edges = [low - 1, high + 1, least, most, 0]
        return min(max(choices.one(edges), least), most)

    def table(self, number: int, choices: Choices) -> bytes:
        """Return the content of a table; `number` is 0 robot, 1 noise, 2 rates, 3 monitors."""
        if choices.once_in(4):
            return (choices.one(TEXTS) % {"joint": self._joints[0]}).encode()
        if number == 0:
            return self.robot(choices)
        schema = self._schemas[(number - 1) % 3]
        text = yaml.safe_dump(self._value(schema, schema.get("$defs", {}), choices))
        return (choices.one(("", "", "a: 1\n", "--- x\n")) + text).encode()

    def robot(self, choices: Choices) -> bytes:
        """Return the robot's URDF with at most two places replaced."""
        text = self._robot
        for _ in range(choices.number(3)):
            pattern, word = choices.one(ROBOT_EDITS)
            place, found = choices.number(4), list(re.finditer(pattern, text))
            if found:
                start, stop = found[min(place, len(found) - 1)].span()
                text = text[:start] + word + text[stop:]
        return text.encode("latin-1" if choices.once_in(16) else "utf-8", "replace")

    def _value(self, schema: dict[str, Any], known: dict[str, Any], choices: Choices) -> Any:  # noqa: ANN401
        """Return a value that a JSON schema allows; sometimes a strange value."""
        if choices.once_in(40):
            return choices.one(STRANGE)
        while "$ref" in schema or "anyOf" in schema:
            inner = choices.one(schema["anyOf"]) if "anyOf" in schema else None
            schema = inner or known[schema["$ref"].rsplit("/", 1)[1]]
        labels = schema.get("enum", [schema["const"]] if "const" in schema else None)
        if labels is not None:
            return choices.one(labels)
        makers: dict[str, Callable[[], Any]] = {
            "object": lambda: self._mapping(schema, known, choices),
            "array": lambda: self._array(schema, known, choices),
            "number": lambda: self._number(schema, choices),
            "integer": lambda: self._number(schema, choices),
            "boolean": lambda: bool(choices.number(2)),
            "string": lambda: choices.one((*WATCHED, "none", "safe")),
        }
        return makers[schema["type"]]() if schema["type"] in makers else None

    def _array(self, schema: dict[str, Any], known: dict[str, Any], choices: Choices) -> list[Any]:
        items = schema.get("prefixItems")
        if items is None:
            count = 200 if choices.once_in(40) else choices.number(4)
            items = [schema["items"]] * count
        return [self._value(item, known, choices) for item in items]

    def _mapping(self, schema: dict[str, Any], known: dict[str, Any], choices: Choices) -> Any:  # noqa: ANN401
        found: dict[Any, Any] = {}
        for name, inner in schema.get("properties", {}).items():
            required = name in schema.get("required", ())
            if required or choices.once_in(2):
                found[name] = self._value(inner, known, choices)
        extra = schema.get("additionalProperties")
        if isinstance(extra, dict):
            names = schema.get("propertyNames", {}).get("enum") or (*self._joints, 1, 2, 8, 20, 99)
            for _ in range(choices.number(3)):
                found[choices.one(names)] = self._value(extra, known, choices)
        if choices.once_in(40):
            found[choices.one(("unknown", "k" * 500, 1 << 900))] = 1
        return found

    @staticmethod
    def _number(schema: dict[str, Any], choices: Choices) -> float | int:
        low = schema.get("minimum", schema.get("exclusiveMinimum", -1.0))
        high = schema.get("maximum", schema.get("exclusiveMaximum", 10.0))
        inside = [v for v in NUMBERS if low <= v <= high]
        edges = [low, high, *inside, 0.5 * (low + high)]
        if choices.once_in(20):
            edges = list(NUMBERS)
        value = choices.one(edges)
        return int(value) if schema["type"] == "integer" and abs(value) < 1e18 else value

    def line(self, choices: Choices) -> bytes:
        """Return one line for the control socket, without the line feed."""
        name = choices.one(self._commands)
        values: dict[str, object] = {"command": name}
        if name == "run_batch" or choices.once_in(8):
            values["method"] = choices.one(("fused", "rda", "ce", "none", 3, ["fused"]))
            values["last_s"] = choices.one((*NUMBERS, *STRANGE, 10**400))
        if name == "run_plan":
            strange = (*NUMBERS, *STRANGE, 10**400, 20.0, 1)
            values |= {key: choices.one(strange) for key in PLAN_BOUNDS}
        if name in ("run_batch", "configure") or choices.once_in(8):
            values["unknown"] = choices.one(("both", "base", "target", [], ["x"], [[[]]], None, 1))
        text = json.dumps(values, default=str).encode()
        kind = choices.number(12)
        hostile = (
            b"[" * 60_000,
            b'{"a":' * 9000,
            choices.raw(40).replace(b"\n", b""),
            b"\xff" * 30,
        )
        return hostile[kind] if kind < len(hostile) else text


def named_telecommand(name: str, values: dict[str, object], sequence: int) -> bytes:
    """Return the packet of a telecommand; values of enumerations may be names."""
    item = DICTIONARY.telecommand(name)
    words = {}
    for field in item.arguments:
        value = values.get(field.name)
        if field.enumeration is not None and isinstance(value, str):
            value = field.enumeration.value(value)
        words[field.name] = value
    return telecommand_packet(item, words, sequence)
