"""The library for processors with Intel AMX, on the registers of a process that is traced."""

import json
import subprocess
import sys

import pytest

from hil.vcan import registers
from hil.vcan.job import VcanError

# A part of the registers is read, one of them (xmm0) is changed, and the part is written back. The
# length is that of a processor with AVX only; every processor that has more refuses it.
TRACE = """
import ctypes, json, os, signal, struct, sys
GETREGSET, SETREGSET, XSTATE, PART = 0x4204, 0x4205, 0x202, 832

class Area(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))

def transfer(request, buffer):
    area = Area(ctypes.addressof(buffer), len(buffer))
    done = library.ptrace(request, pid, ctypes.c_void_p(XSTATE), ctypes.byref(area))
    return done, area.length

library = ctypes.CDLL(sys.argv[1] or None, use_errno=True)
library.ptrace.restype = ctypes.c_long
pid = os.fork()
if pid == 0:
    library.ptrace(0, 0, None, None)
    os.kill(os.getpid(), signal.SIGSTOP)
    os._exit(7)
os.waitpid(pid, 0)
whole = ctypes.create_string_buffer(1 << 16)
_, size = transfer(GETREGSET, whole)
part = ctypes.create_string_buffer(whole.raw[:PART], PART)
part[160:176] = bytes(range(16))
(states,) = struct.unpack_from("<Q", part, 512)
struct.pack_into("<Q", part, 512, states | 2)
done, _ = transfer(SETREGSET, part)
transfer(GETREGSET, whole)
unknown = library.ptrace(0x4204, pid, ctypes.c_void_p(0x999), None)
library.ptrace(7, pid, None, None)
print(json.dumps([size, done, whole.raw[160:176].hex(), unknown, os.waitpid(pid, 0)[1] >> 8]))
"""


def traced(library) -> list:
    """Return size of all registers, result of the write, xmm0 after it, and the exit status."""
    done = subprocess.run(
        [sys.executable, "-c", TRACE, str(library)], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return registers.build(tmp_path_factory.mktemp("registers"))


def test_a_part_of_the_registers_is_written_whole(library):
    _, done, xmm0, unknown, status = traced(library)
    assert done == 0
    assert xmm0 == bytes(range(16)).hex()
    assert unknown == -1  # other requests pass as they are
    assert status == 7


def test_the_kernel_alone_refuses_a_part():
    size, done, xmm0, _, status = traced("")
    if size <= 832:
        pytest.skip("this processor has no more registers than the part")
    assert done == -1
    assert xmm0 != bytes(range(16)).hex()
    assert status == 7


def test_amx_is_told_by_its_flag(tmp_path):
    path = tmp_path / "cpuinfo"
    path.write_text("flags\t\t: fpu avx512f amx_bf16 amx_tile\n")
    assert registers.are_too_large(path)
    path.write_text("flags\t\t: fpu avx512f\n")
    assert not registers.are_too_large(path)


def test_a_missing_compiler_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(VcanError, match="apt-get install gcc libc6-dev"):
        registers.build(tmp_path)
