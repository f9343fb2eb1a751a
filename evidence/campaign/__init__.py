"""Monte Carlo campaigns over seeds, noise, trajectories and robots, on this machine or on Dask."""
