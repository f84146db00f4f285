"""The subjects of a run: the programs of a suite, programs that are observed, a graph of nodes."""
