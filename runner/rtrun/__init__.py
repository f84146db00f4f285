"""The runner: campaigns on a target, samples pulled back, analysed, reported, gated."""
