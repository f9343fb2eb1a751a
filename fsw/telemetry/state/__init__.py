"""State: the values that telemetry reports, and the files that keep them over a power cut."""
