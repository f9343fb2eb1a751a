"""From windows of samples to blocks: values of all channels at common instants."""
