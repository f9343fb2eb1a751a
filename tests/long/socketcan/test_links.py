"""The links `hil vcan` gives a command."""

import subprocess
import sys
from pathlib import Path

import can
import pytest

from hil.vcan import kernel, links


@pytest.mark.parametrize("channel", ["vcan0", "vcan1"])
@pytest.mark.parametrize(("fd", "length"), [(False, 8), (True, 64)])
def test_both_frame_formats_pass_between_two_ends(channel, fd, length):
    sent = can.Message(
        arbitration_id=0x191,
        data=bytes(range(length)),
        is_extended_id=False,
        is_fd=fd,
        bitrate_switch=fd,
    )
    with (
        can.Bus(interface="socketcan", channel=channel, fd=fd) as one,
        can.Bus(interface="socketcan", channel=channel, fd=fd) as other,
    ):
        one.send(sent)
        got = other.recv(10.0)
    assert got is not None
    assert sent.equals(got, timestamp_delta=None, check_channel=False, check_direction=False)


def vcan(*options, command):
    """Run a command below `hil vcan` on this kernel, which has CAN."""
    return subprocess.run(
        [sys.executable, "-m", "hil", "vcan", *options, "--", *command],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_where_the_kernel_has_the_links_the_command_runs_on_them():
    text = "import os, sys; print(os.environ['HIL_VCAN']); sys.exit(9)"
    done = vcan(command=(sys.executable, "-c", text))
    assert (done.returncode, done.stdout, done.stderr) == (9, "kernel\n", "")


def test_a_missing_link_is_made_for_the_command_and_removed_after_it():
    subprocess.run(["ip", "link", "delete", "dev", "vcan1"], check=True)
    try:
        done = vcan("--on", "kernel", command=("cat", "/sys/class/net/vcan1/mtu"))
        assert (done.returncode, done.stdout) == (0, "72\n")
        assert not Path("/sys/class/net/vcan1").exists()
        assert Path("/sys/class/net/vcan0").exists()
    finally:
        lines = links.added(("vcan1",))
        subprocess.run(["ip", "-batch", "-"], input=lines, text=True, check=True)


def test_signals_and_the_end_of_the_time_are_told_as_in_user_mode_linux():
    assert vcan(command=("sh", "-c", "kill -SEGV $$")).returncode == 128 + 11
    assert vcan("--timeout", "1", command=("sleep", "100")).returncode == 124
    assert vcan(command=("no-such-command",)).returncode == 127


def test_two_runs_do_not_share_the_links():
    with kernel.claimed() as first, kernel.claimed() as second:
        assert (first, second) == (True, False)
