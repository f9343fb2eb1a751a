"""The CAN links of a command, as lines for `ip -batch`."""

NAMES = ("vcan0", "vcan1")
FD_MTU = 72  # bytes of a canfd_frame: both frame formats pass


def added(names: tuple[str, ...] = NAMES) -> str:
    """Return the lines that add the links and set each link up."""
    lines = []
    for name in names:
        lines.append(f"link add dev {name} type vcan")
        lines.append(f"link set dev {name} mtu {FD_MTU} up")
    return "\n".join(lines) + "\n"


def deleted(names: tuple[str, ...]) -> str:
    """Return the lines that remove the links."""
    return "".join(f"link delete dev {name}\n" for name in names)


def loopback() -> str:
    """Return the lines that set the loopback link up, with a route for multicast."""
    return "link set dev lo up multicast on\nroute add 239.0.0.0/8 dev lo\n"
