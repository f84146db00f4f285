"""What a target is: its facts, and what on it hinders real-time programs."""
