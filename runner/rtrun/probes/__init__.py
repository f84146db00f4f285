"""What do running programs do? Kernel probes on the functions of their libraries."""
