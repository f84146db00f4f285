"""What a target is: its facts, and what hinders real-time programs there."""
