"""What every folder reads and writes with: sealed HDF5, files that are whole, tables, units, progress."""
