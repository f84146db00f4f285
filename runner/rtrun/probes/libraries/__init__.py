"""Which functions of a library tell of messages, timers and callbacks: one file of data for each library."""
