"""Service: the process that records, keeps checkpoints, serves commands, and runs batch jobs."""
