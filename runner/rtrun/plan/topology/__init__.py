"""A graph of nodes to be run and measured: what a topology file says, and what follows from it without a target."""
