"""Loop: the process that reads devices, runs the scheduler and feeds the estimator."""
