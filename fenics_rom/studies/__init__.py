"""What accuracy costs in time: reduced runs of a scene against its full-order run, over orders, steps and methods."""
