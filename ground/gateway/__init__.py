"""The live page: telemetry decoded by the XTCE, shown by Open MCT. It commands nothing."""
