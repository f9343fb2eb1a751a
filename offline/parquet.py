"""Tables as Parquet files, by pyarrow."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from file_delivery.extras import needs
from fsw.errors import ConfigError


def require_pyarrow() -> None:
    """Check that pyarrow is installed, so that a long command fails early.

    Raises
    ------
    ConfigError if pyarrow is not installed.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise ConfigError(needs("Parquet", "pyarrow", "parquet")) from error


def write_parquet(
    path: Path, columns: Mapping[str, Iterable[Any]], facts: Mapping[str, str] | None = None
) -> None:
    """Write `columns` (values by name) as a table; `facts` become metadata of its schema.

    Raises
    ------
    ConfigError if pyarrow is not installed; OSError when the file cannot be written.
    """
    require_pyarrow()
    import pyarrow
    from pyarrow import parquet

    table = pyarrow.table(dict(columns))
    parquet.write_table(table.replace_schema_metadata(dict(facts or {})), path)
