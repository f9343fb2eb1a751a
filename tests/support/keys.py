"""Key files as an operator makes them."""

from pathlib import Path


def write_key(path: Path, key: bytes, mode: int = 0o600) -> Path:
    """Write a key, or replace it in one step; return its path."""
    new = path.with_name(f"new {path.name}")
    new.write_bytes(key)
    new.chmod(mode)
    return new.replace(path)
