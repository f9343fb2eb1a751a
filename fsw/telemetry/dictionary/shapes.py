"""Functions that make telecommands and packets of their parts, and arguments that several share."""

from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, FUNCTION, Function
from fsw.telemetry.dictionary.events import EVENT
from fsw.telemetry.dictionary.housekeeping import PATH_BYTES
from fsw.telemetry.dictionary.types import Field, Packet, Telecommand, Type

PATH = Field(name="path", type=Type.TEXT, size=PATH_BYTES, doc="below the file directory")
AN_EVENT = Field(name="event", type=Type.U16, enumeration=EVENT)
MONITOR_ID = Field(name="monitor", type=Type.U16, minimum=1)
SOURCE = Field(name="source_id", type=Type.U16, doc="of the telecommand")
ORIGIN = (  # of a telecommand, behind its source
    Field(name="apid", type=Type.U16, maximum=0x7FF),
    Field(name="sequence_count", type=Type.U16, maximum=0x3FFF),
)


def telecommand(
    service: int, subtype: int, name: str, doc: str, *arguments: Field, repeats: bool = False
) -> Telecommand:
    """Return a telecommand without fixed arguments, accepted in every mode."""
    return Telecommand(
        name=name, service=service, subtype=subtype, doc=doc, arguments=arguments, repeats=repeats
    )


def function(
    function: Function, doc: str, *arguments: Field, accepted_in: tuple[str, ...] = ()
) -> Telecommand:
    """Return the telecommand of a function of service 8; `accepted_in`: in every mode if empty."""
    number = Field(name="function_id", type=Type.U16, enumeration=FUNCTION)
    return Telecommand(
        name=function.name,
        service=8,
        subtype=1,
        doc=doc,
        arguments=(number, *arguments),
        match=(("function_id", int(function)),),
        accepted_in=accepted_in,
    )


def met(name: str) -> tuple[Field, ...]:
    """Return the argument fields of a mission elapsed time, as CUC 4+3 with P-field."""
    return (
        Field(name=f"{name}_p_field", type=Type.U8, minimum=0x2F, maximum=0x2F),
        Field(name=f"{name}_coarse_s", type=Type.U32, unit="s"),
        Field(name=f"{name}_fine", type=Type.U24, doc="2^-24 s"),
    )


def report(service: int, subtype: int, name: str, doc: str, *fields: Field) -> Packet:
    """Return a packet of the estimator's application."""
    return Packet(
        name=name, apid=APID_ESTIMATOR, service=service, subtype=subtype, doc=doc, fields=fields
    )
