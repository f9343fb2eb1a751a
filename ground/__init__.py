"""An ordinary client of the daemon: commands, telemetry, files and a live page."""
