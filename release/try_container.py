"""Carry out the Containerfile without a container engine, in folders with a Debian each; as root.

`debootstrap --variant=minbase bookworm ROOT && python release/try_container.py ROOT WORK`. ROOT
stays as it is; every stage works on a copy in WORK. Ends with `fsw --version` and `fsw init list`
as the image's user.
"""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parents[1]
LENT = ("/etc/resolv.conf", "/etc/pip.conf", "/etc/ssl/certs/ca-certificates.crt")  # of the host
LENT_VALUES = ("PIP_", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "http")  # names begin so


def instructions(path: Path) -> Iterator[tuple[str, str]]:
    """Yield keyword and rest of every instruction."""
    for line in path.read_text(encoding="utf-8").replace("\\\n", "").splitlines():
        if line.strip() and not line.startswith("#"):
            keyword, _, rest = line.partition(" ")
            yield keyword, rest


def inside(root: Path, words: list[str], values: dict[str, str], user: str, folder: str) -> None:
    """Run a command in a stage, with what the host lends it for its network."""
    for name in LENT:
        if Path(name).exists():
            (root / name[1:]).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(name, root / name[1:])
    script = f'cd {shlex.quote(folder)} && exec "$@"'
    whole = [
        shutil.which("chroot") or "",
        f"--userspec={user}",
        str(root),
        "/bin/sh",
        "-c",
        script,
        "sh",
        *words,
    ]
    own = {key: value for key, value in os.environ.items() if key.startswith(LENT_VALUES)}
    path = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"}
    subprocess.run(whole, env={**own, **path, **values}, check=True)


def copy(words: list[str], stages: dict[str, Path], root: Path) -> None:
    """Carry out COPY, from the repository or another stage."""
    source = HERE
    if words[0].startswith("--from="):
        source = stages[words.pop(0).partition("=")[2]]
    *names, target = words
    for name in names:
        origin, goal = source / name.lstrip("/"), root / target.lstrip("/")
        goal = goal / origin.name if target.endswith("/") else goal
        goal.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run(["cp", "-a", "-T", str(origin), str(goal)], check=True)


def main(base: Path, work: Path) -> None:
    """Carry out every instruction, then the image's program."""
    stages: dict[str, Path] = {}
    root, values, user, folder, entry = work, dict[str, str](), "root", "/", ""
    for keyword, rest in instructions(HERE / "Containerfile"):
        print(keyword, rest, flush=True)
        match keyword:
            case "FROM":
                name = rest.rpartition(" AS ")[2] if " AS " in rest else "last"
                root = stages[name] = work / name
                values, user, folder = {}, "root", "/"
                subprocess.run(["cp", "-a", str(base), str(root)], check=True)
            case "RUN":
                inside(root, ["/bin/sh", "-c", rest], values, user, folder)
            case "COPY":
                copy(shlex.split(rest), stages, root)
            case "ENV":
                values |= dict(pair.split("=", 1) for pair in shlex.split(rest))
            case "USER":
                user = rest
            case "WORKDIR":
                folder = rest
                (root / rest[1:]).mkdir(parents=True, exist_ok=True)
            case "ENTRYPOINT":
                entry = rest.strip('["]')
            case "CMD":
                inside(root, [entry, rest.strip('["]')], values, user, folder)
            case _:
                raise ValueError(f"{keyword}: not known here")
    inside(root, [entry, "--version"], values, user, folder)
    inside(root, [entry, "init", "list"], values, user, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
