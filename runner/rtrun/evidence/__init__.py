"""What was seen of a system, and what was not: every answer rests on this account."""
