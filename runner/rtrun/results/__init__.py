"""What a run leaves behind: the run directory, its closing record, the programs' files, and their readers."""
