"""Ground programs, clients of the daemon: commands, telemetry, files and a live page."""
