"""The library that lets User-Mode Linux run on processors with Intel AMX.

`registers.c` says why it is needed. It is compiled on the machine that needs it.
"""

import shutil
import subprocess
from pathlib import Path

from hil.vcan.job import VcanError

SOURCE = Path(__file__).with_suffix(".c")
PROCESSORS = Path("/proc/cpuinfo")
FLAG = "amx_tile"
OPTIONS = ("-O2", "-shared", "-fPIC")


def are_too_large(processors: Path = PROCESSORS) -> bool:
    """Return whether the processor has registers that Debian's User-Mode Linux does not know."""
    return FLAG in processors.read_text(encoding="ascii", errors="replace").split()


def build(folder: Path) -> Path:
    """Compile the library into a folder; return its path.

    Raises
    ------
    VcanError without a C compiler and the C library's headers.
    """
    library = folder / "registers.so"
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise VcanError(
            "this processor has Intel AMX, for which a C compiler is needed;"
            " apt-get install gcc libc6-dev"
        )
    done = subprocess.run(
        [compiler, *OPTIONS, "-o", str(library), str(SOURCE)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise VcanError(f"{SOURCE.name} does not compile (libc6-dev?): {done.stderr.strip()}")
    return library
