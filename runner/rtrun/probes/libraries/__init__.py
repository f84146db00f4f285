"""Which functions of a library show messages, timers and callbacks: one file of data for each library."""
