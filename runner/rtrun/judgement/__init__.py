"""What is the answer? Runs are read and digested, groups of them judged: verdicts, gate, comparison, claims."""
