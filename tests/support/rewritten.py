"""A recording written again with changes, as a broken recorder would have written it."""

from collections.abc import Callable
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer

# topic, seconds from the start and data of a message to a shift of its stamp [s] and its data
Change = Callable[[str, float, bytes], tuple[float, bytes]]


def rewritten(source: Path, target: Path, change: Change) -> Path:
    """Write every message again, its stamp shifted [s] and its data replaced by `change`."""
    with source.open("rb") as file, target.open("wb") as out:
        reader, writer = make_reader(file), Writer(out)
        summary = reader.get_summary()
        assert summary is not None
        writer.start(library="rewritten")
        schemas = {
            number: writer.register_schema(schema.name, schema.encoding, schema.data)
            for number, schema in summary.schemas.items()
        }
        channels = {
            number: writer.register_channel(
                c.topic, c.message_encoding, schemas.get(c.schema_id, 0), c.metadata
            )
            for number, c in summary.channels.items()
        }
        held = list(reader.iter_messages(log_time_order=False))
        start_ns = min(message.log_time for _, _, message in held)
        for _, channel, message in held:
            elapsed_s = (message.log_time - start_ns) * 1e-9
            shift_s, data = change(channel.topic, elapsed_s, message.data)
            t_ns = message.log_time + round(shift_s * 1e9)
            writer.add_message(channels[channel.id], t_ns, data, t_ns, message.sequence)
        for one in reader.iter_metadata():
            writer.add_metadata(one.name, dict(one.metadata))
        writer.finish()
    return target
