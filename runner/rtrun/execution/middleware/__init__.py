"""What is done on a target for each middleware: one module each."""
