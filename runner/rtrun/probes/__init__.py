"""What do programs do that run already? Probes of the kernel on the functions of their libraries."""
