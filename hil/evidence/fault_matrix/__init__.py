"""The fault matrix: every fault in a seeded run, held against bounds that stood before it."""
