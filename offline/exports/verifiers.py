"""Verification reports of service 1 as XTCE verifiers of a command.

A report with the command's sequence count decides whether a stage succeeds or fails. XTCE has no
masked comparison of two parameters that all readers support, so each check is an algorithm in
JavaScript. `/yamcs/cmdHist/ccsds-seqcount` is the sequence count that Yamcs gave the command.
"""

from collections.abc import Sequence

from yamcs.pymdb.algorithms import InputParameter, UnnamedAlgorithm
from yamcs.pymdb.commands import Command
from yamcs.pymdb.verifiers import (
    AcceptedVerifier,
    AlgorithmCheck,
    CompleteVerifier,
    ExecutionVerifier,
)

from fsw.telemetry.dictionary import Telecommand

SENT = "/yamcs/cmdHist/ccsds-seqcount"
COUNT_MASK = 0x3FFF
ALGORITHM = '<CustomAlgorithm name="Unnamed"'
ACCEPTANCE, START, PROGRESS, COMPLETION = 1, 3, 5, 7
REPORTS = {  # subtype of success -> packet of success, packets of failure
    ACCEPTANCE: ("acceptance_success", ("acceptance_failure", "routing_failure")),
    START: ("start_success", ("start_failure",)),
    PROGRESS: ("progress_success", ("progress_failure",)),
    COMPLETION: ("completion_success", ("completion_failure",)),
}


def add_verifiers(command: Command, telecommand: Telecommand) -> None:
    """Add to a command one verifier for each success report of its telecommand."""
    for subtype in telecommand.verification:
        check, timeout_s = _check(command, subtype), telecommand.timeout_s
        if subtype == ACCEPTANCE:
            command.accepted_verifier = AcceptedVerifier(check, timeout_s)
        elif subtype == COMPLETION:
            command.complete_verifiers.append(CompleteVerifier(check, timeout_s))
        else:
            name = "Start" if subtype == START else "Progress"
            command.execution_verifiers.append(ExecutionVerifier(check, timeout_s, name=name))


def _check(command: Command, subtype: int) -> AlgorithmCheck:
    success, failures = REPORTS[subtype]
    system = command.system
    reports = {"success": system.find_parameter(f"{success}_request_sequence")}
    lines = [_line("success", "true")]
    for place, failure in enumerate(failures):
        reports[f"failure{place}"] = system.find_parameter(f"{failure}_request_sequence")
        reports[f"error{place}"] = system.find_parameter(f"{failure}_error")
        lines.append(_line(f"failure{place}", f"String(error{place}.value)"))
    inputs = [InputParameter(SENT, name="sent", required=True)]
    inputs += [InputParameter(report, name=name) for name, report in reports.items()]
    return AlgorithmCheck(UnnamedAlgorithm(language="JavaScript", text=_text(lines), inputs=inputs))


def _line(report: str, result: str) -> str:
    named = f"({report}.value & {COUNT_MASK}) == sent.value"
    return f"if ({report} != null && {named}) return {result};"


def _text(lines: Sequence[str]) -> str:
    return "\n".join([*lines, "return null;"])


def with_names(xtce: str) -> str:
    """Return an XTCE document in which the verifier algorithms of a command have different names.

    pymdb names all of them `Unnamed`. Yamcs refuses such a command: it runs one algorithm per name.
    """
    found, count = [], 0
    for line in xtce.splitlines(keepends=True):
        count = 0 if "<VerifierSet" in line else count
        if ALGORITHM in line:
            count += 1
            line = line.replace(ALGORITHM, f'<CustomAlgorithm name="verifier_{count}"')  # noqa: PLW2901
        found.append(line)
    return "".join(found)
