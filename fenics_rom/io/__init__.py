"""Files, tables, units and progress: what every folder writes with."""
