"""What was seen of a system, and what was not: the account that every answer rests on."""
