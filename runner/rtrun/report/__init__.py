"""From run directories to the answer: read, digest, judge, and write it down in one of several formats."""
