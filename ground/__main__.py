"""Ground side of the daemon: telecommands, telemetry, files, a live page.

Exit codes: 0 done, 1 no link, 2 wrong command line, 3 rejected, 4 failed, 5 no answer in time.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from file_delivery.extras import cure
from ground.errors import LINK, USAGE, GroundError
from ground.examples import EXAMPLES, FILES
from ground.sdls import Sealer

if TYPE_CHECKING:
    from ground.downlink import FrameStream
    from ground.gateway.desk import Desk

PORT = 10025
STATE = Path("~/.local/state/ground")
MET_END_S = float((1 << 32) - 1)  # the last mission elapsed time that a packet can name


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    arguments = parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        return command(arguments)
    except GroundError as error:
        print(f"ground: {error}", file=sys.stderr)
        return error.exit_code
    except ModuleNotFoundError as error:
        print(f"ground: {cure(error, 'ground')}", file=sys.stderr)
        return USAGE
    except (BrokenPipeError, KeyboardInterrupt):
        return LINK


def parser() -> argparse.ArgumentParser:
    """Return the parser of every command, for completion and documentation too."""
    program = argparse.ArgumentParser(prog="ground", description=__doc__)
    release = f"%(prog)s {version('inertia-daemon')}"
    program.add_argument("--version", action="version", version=release)
    program.add_argument("--host", default="127.0.0.1", help="of the daemon, 127.0.0.1")
    program.add_argument("--port", type=_port, default=PORT, help=f"of its link, {PORT}")
    sealing = program.add_argument_group("authenticated telecommands (tc_security: sdls)")
    sealing.add_argument("--key", type=Path, metavar="FILE", help="32 bytes, mode 0600")
    sealing.add_argument(
        "--spi", type=int, default=1, help="security parameter index of the key, 1"
    )
    sealing.add_argument("--spacecraft-id", type=int, default=42, metavar="N", help="42")
    sealing.add_argument("--virtual-channel", type=int, default=0, metavar="N", help="0")
    sealing.add_argument(
        "--standard-mask",
        action="store_true",
        help="for authenticate_spacecraft: false, the mask of CCSDS 355.0-B",
    )
    sealing.add_argument(
        "--tm-key", type=Path, metavar="FILE", help="the key that seals telemetry, mode 0600"
    )
    sealing.add_argument("--tm-spi", type=int, default=2, help="its security parameter index, 2")
    sealing.add_argument(
        "--state", type=Path, default=STATE, metavar="DIR", help="numbers used so far"
    )
    commands = program.add_subparsers(required=True, metavar="COMMAND")
    _tc_parser(commands)
    number = commands.add_parser("number", help="show or set the next number of --key")
    number.add_argument("number", nargs="?", type=int, metavar="N", help="set it")
    number.set_defaults(command=_command("ground.show:show_number", _sealer))
    _history_parser(commands)
    _tm_parser(commands)
    _onboard_parser(commands)
    _file_parser(commands)
    _serve_parser(commands)
    for name, example in EXAMPLES.items():
        commands.choices[name].epilog = f"example: {example}"
    return program


def _seconds(text: str) -> float:
    value = float(text)
    if not math.isfinite(value) or value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text}: must be a finite number above 0")
    return value


def _met(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= MET_END_S:
        raise argparse.ArgumentTypeError(f"{text}: must be 0 to {MET_END_S:.0f}")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be at least 1")
    return value


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"{text}: must be 0 to 65535")
    return value


def _tc_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    listing = commands.add_parser("list", help="list telecommands, or one with its arguments")
    listing.add_argument("name", nargs="?", metavar="NAME")
    listing.set_defaults(command=_command("ground.show:list_commands"))
    tc = commands.add_parser("tc", help="send a telecommand and follow it to its end")
    tc.add_argument("name", metavar="NAME", help="from `ground list`")
    tc.add_argument("arguments", nargs="*", metavar="ARGUMENT=VALUE")
    kept = tc.add_mutually_exclusive_group()
    kept.add_argument(
        "--at", type=_seconds, metavar="S", help="keep it until then, mission elapsed"
    )
    kept.add_argument("--on", metavar="EVENT", help="keep it as the action of an event, disabled")
    tc.add_argument("--timeout", type=_seconds, default=10.0, metavar="S", help="10")
    tc.add_argument("--force", action="store_true", help="send values out of range")
    tc.add_argument("--json", action="store_true", help="print one JSON object")
    tc.set_defaults(command=_command("ground.show:send", _sealer, _stream))


def _history_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    history = commands.add_parser("history", help="show the commands that were sent from here")
    history.add_argument("--count", type=_count, default=20, metavar="N", help="20")
    history.add_argument("--json", action="store_true", help="one JSON object a line")
    history.set_defaults(command=_command("ground.show:show_history"))


def _tm_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    tm = commands.add_parser("tm", help="show telemetry as it comes")
    tm.add_argument("packets", nargs="*", metavar="PACKET", help="only these; all when none")
    tm.add_argument("--field", action="append", default=[], metavar="NAME", help="only these")
    tm.add_argument("--count", type=_count, metavar="N", help="stop after so many packets")
    tm.add_argument("--seconds", type=_seconds, default=1e9, metavar="S", help="stop after so long")
    tm.add_argument("--json", action="store_true", help="one JSON object a line")
    tm.add_argument("--raw", type=Path, metavar="FILE", help="also keep the packets as they come")
    tm.set_defaults(command=_command("ground.show:watch", _stream))


def _onboard_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    back = commands.add_parser("playback", help="retrieve stored telemetry into a file")
    back.add_argument("stores", nargs="*", metavar="STORE", help="packet stores; all when none")
    back.add_argument(
        "--missed", type=Path, metavar="FILE", help="of `tm --raw`: add to it whatever it lacks"
    )
    back.add_argument("--out", type=Path, metavar="FILE", help="add the packets to this file")
    back.add_argument("--from", dest="start", type=_met, default=0.0, metavar="S", help="0: oldest")
    back.add_argument("--to", dest="end", type=_met, default=MET_END_S, metavar="S", help="now")
    back.add_argument("--timeout", type=_seconds, default=600.0, metavar="S", help="600")
    back.set_defaults(command=_command("ground.show_onboard:play_back", _sealer, _stream))
    sequence = commands.add_parser("sequence", help="load a sequence of telecommands from a text")
    sequence.add_argument("number", type=_count, metavar="N", help="its place, from 1")
    sequence.add_argument(
        "file", type=Path, metavar="FILE", help="a telecommand, or wait S, a line"
    )
    sequence.add_argument("--start", action="store_true", help="start it once it is loaded")
    sequence.add_argument("--timeout", type=_seconds, default=60.0, metavar="S", help="60")
    loaded = _command("ground.show_onboard:load_sequence", _sealer, _stream)
    sequence.set_defaults(command=loaded, json=False)


def _file_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    files = commands.add_parser("file", help="transfer and manage files of the daemon")
    files.add_argument(
        "--timeout", type=_seconds, default=600.0, metavar="S", help="of a transfer, 600"
    )
    files.add_argument(
        "--wait", type=_seconds, default=60.0, metavar="S", help="for a daemon that is gone, 60"
    )
    files.add_argument("--piece", type=_count, default=4 << 20, metavar="B", help=argparse.SUPPRESS)
    actions = files.add_subparsers(required=True, metavar="ACTION")

    def action(name: str, method: str, words: str, *arguments: str) -> argparse.ArgumentParser:
        parser = actions.add_parser(name, help=words)
        for argument in arguments:
            parser.add_argument(argument, metavar=argument.upper())
        parser.set_defaults(command=_file, method=method)
        return parser

    get = action("get", "get", "fetch a file and compare its CRC", "remote")
    get.add_argument("local", nargs="?", type=Path, metavar="LOCAL")
    put = action("put", "put", "send a file into the folder `files`")
    put.add_argument("local", type=Path, metavar="LOCAL")
    put.add_argument("remote", nargs="?", metavar="REMOTE")
    action("list", "list", "list a folder", "remote")
    action("transfers", "transfers", "list the transfers that are not over")
    resume = action("resume", "resume", "continue an interrupted transfer, or all of them")
    resume.add_argument("id", nargs="?", metavar="ID", help="from `transfers`; all when none")
    action("cancel", "cancel", "cancel a transfer, by its ID or SOURCE/NUMBER in `transfers`", "id")
    action("rename", "rename", "move or rename a file or a folder", "remote", "target")
    action("mkdir", "make_folder", "create a folder", "remote")
    action("rm", "remove", "remove a file or an empty folder", "remote")
    action("free", "free", "show the free space of each folder")
    for name, example in FILES.items():
        actions.choices[name].epilog = f"example: {example}"


def _serve_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    fetch = commands.add_parser("fetch-assets", help="fetch Open MCT by npm, once")
    fetch.add_argument("--assets", type=Path, metavar="DIR", help="where to keep it")
    fetch.set_defaults(command=_fetch)
    serve = commands.add_parser("serve", help="live page in the browser")
    serve.add_argument(
        "--command",
        dest="command_from_page",
        action="store_true",
        help="the page may command too, each command after a confirmation; needs the token",
    )
    serve.add_argument(
        "--http-host", default="127.0.0.1", help="127.0.0.1; another needs --http-token"
    )
    serve.add_argument(
        "--http-token",
        type=Path,
        metavar="FILE",
        help="what a browser must show, mode 0600; with --command a random one without it",
    )
    serve.add_argument("--http-port", type=_port, default=8080, help="8080; 0: any free one")
    serve.add_argument("--assets", type=Path, metavar="DIR", help="of `ground fetch-assets`")
    serve.add_argument(
        "--recordings", type=Path, metavar="PATH", help="recording or folder of them, for history"
    )
    serve.set_defaults(command=_serve)


def _command(
    function: str, *made: Callable[[argparse.Namespace], object]
) -> Callable[[argparse.Namespace], int]:
    """Return what calls a function, imported then, with the arguments and what is made of them."""

    def call(arguments: argparse.Namespace) -> int:
        module, name = function.split(":")
        given = (make(arguments) for make in made)
        return int(getattr(import_module(module), name)(arguments, *given))

    return call


def _file(arguments: argparse.Namespace) -> int:
    from ground.files import Files
    from ground.show import opened

    files = Files(arguments, lambda: opened(arguments, _sealer(arguments), _stream(arguments)))
    command: Callable[[], int] = getattr(files, arguments.method)
    return command()


def _fetch(arguments: argparse.Namespace) -> int:
    from ground.assets import default_folder, fetch

    print(fetch(arguments.assets or default_folder()))
    return 0


def _serve(arguments: argparse.Namespace) -> int:
    from ground.downlink import ClearStream
    from ground.gateway.server import serve

    desk = _desk(arguments) if arguments.command_from_page else None
    return serve(arguments, lambda: _stream(arguments) or ClearStream(), desk)


def _desk(arguments: argparse.Namespace) -> Desk:
    from ground.gateway.desk import Desk
    from ground.history import CommandHistory
    from ground.show import opened

    target = f"{arguments.host}:{arguments.port}"
    return Desk(
        lambda: opened(arguments, _sealer(arguments), _stream(arguments)),
        CommandHistory(arguments.state, target),
    )


def _sealer(arguments: argparse.Namespace) -> Sealer | None:
    if arguments.key is None:
        return None
    return Sealer(arguments.key, spi=arguments.spi, **_channel(arguments))


def _stream(arguments: argparse.Namespace) -> FrameStream | None:
    if arguments.tm_key is None:
        return None
    from ground.downlink import FrameStream

    return FrameStream(arguments.tm_key, spi=arguments.tm_spi, **_channel(arguments))


def _channel(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what sealing and opening frames have in common."""
    return {
        "state_folder": arguments.state.expanduser(),
        "spacecraft_id": arguments.spacecraft_id,
        "virtual_channel": arguments.virtual_channel,
        "names_spacecraft": not arguments.standard_mask,
    }


if __name__ == "__main__":
    sys.exit(main())
