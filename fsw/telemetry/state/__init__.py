"""State: the values that telemetry reports, and files that survive a power cut."""
