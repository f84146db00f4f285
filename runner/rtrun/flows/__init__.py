"""Which messages, timers and callbacks were there? The hits of probes show them."""
