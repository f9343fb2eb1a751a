"""What is missing or taken is said in one line."""

import socket
import subprocess
import sys

import pytest

WITHOUT = """
import sys
sys.modules["space_packet_parser"] = sys.modules["aiohttp"] = None
from ground.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "arguments", [["tc", "PING"], ["tm"], ["list"], ["file", "list", "files"], ["serve"]], ids=str
)
def test_without_its_packages_the_ground_says_what_to_install(arguments, tmp_path):
    command = [sys.executable, "-c", WITHOUT, "--state", str(tmp_path), *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert "pip install 'inertia-daemon[ground]'" in line


def test_without_its_packages_the_ground_gives_help():
    command = [sys.executable, "-c", WITHOUT, "--help"]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0


def test_a_port_in_use_is_named(tmp_path):
    (tmp_path / "openmct.js").write_text("// Open MCT")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "ground", "serve", "--assets", str(tmp_path)]
        command += ["--http-port", str(port)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert f"--http-port {port}" in line
    assert "in use" in line
