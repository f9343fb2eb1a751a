"""Yamcs as PyPI brings it (`fprime-yamcs-bundle`), with the project's own configuration of it."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from ground.dictionary import XTCE

PYTHON = Path(sys.prefix) / "yamcs" / "bin" / "python"
SHIPPED = XTCE.parent / "yamcs"
INSTANCE = "inertia"


def _jars() -> str:
    (folder,) = PYTHON.parents[1].glob("lib/python*/site-packages/fprime_yamcs_bundle/lib")
    return f"{folder}/*"


def write_configuration(folder: Path, *, http_port: int, port: int, epoch_utc: str) -> None:
    """Write the shipped configuration with what an operator fills in."""
    etc = folder / "etc"
    etc.mkdir(parents=True)
    (folder / "data").mkdir()
    shutil.copy(XTCE, etc)
    shutil.copy(SHIPPED / "processor.yaml", etc)
    instance = yaml.safe_load((SHIPPED / "yamcs.inertia.yaml").read_text())
    (link,) = instance["dataLinks"]
    link["port"] = port
    link["packetPreprocessorArgs"]["timeEncoding"]["epochUTC"] = epoch_utc
    instance["mdb"][0]["args"]["file"] = str(etc / XTCE.name)
    (etc / "yamcs.inertia.yaml").write_text(yaml.safe_dump(instance))
    http = {"address": "127.0.0.1", "port": http_port}
    server = {
        "services": [{"class": "org.yamcs.http.HttpServer", "args": http}],
        "instances": [INSTANCE],
        "dataDir": str(folder / "data"),
    }
    (etc / "yamcs.yaml").write_text(yaml.safe_dump(server))


@contextmanager
def yamcs(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run Yamcs for a block; its output is in the file `log`."""
    java = shutil.which("java") or str(PYTHON.with_name("java"))
    command = [java, "-Xmx500m", "-XX:TieredStopAtLevel=1", "-cp", _jars()]
    command += ["org.yamcs.YamcsServer", "--etc-dir", str(folder / "etc")]
    command += ["--data-dir", str(folder / "data")]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)
        try:
            yield process
        finally:
            process.kill()
            process.wait()
