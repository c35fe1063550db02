"""Tools of the command line: speed (bench, against), a run's plan before it starts, and the check of a finished run."""
