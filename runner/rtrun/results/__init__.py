"""What a run leaves: the run directory, its closing record, the files of the programs, and their readers."""
