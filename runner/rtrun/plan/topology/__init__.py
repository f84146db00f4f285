"""A graph of nodes to run and measure: the contents of a topology file, and what follows from it without a target."""
