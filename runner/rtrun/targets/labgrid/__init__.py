"""A board that a labgrid farm lends."""
