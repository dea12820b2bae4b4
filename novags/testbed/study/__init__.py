"""Studies: grids of runs from one TOML file, on all cores of a machine, resumable, with shared stages made once."""
