"""Which messages, timers and callbacks were there? Read from the hits of probes."""
