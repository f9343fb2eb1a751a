"""The live page: telemetry decoded by the XTCE, shown by Open MCT; commanding is optional."""
