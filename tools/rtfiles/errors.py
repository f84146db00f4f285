"""The errors that end a command, and the exit status of each (0 done and 1 gate failed are results, not errors)."""

DEFECT_STATUS = 70  # a defect of the program itself: EX_SOFTWARE of sysexits.h
INTERRUPTED_STATUS = 130  # as a shell reports Ctrl-C


class UsageError(Exception):
    """The user's request is wrong: a command line, a config file, a missing input. The message is the remedy."""

    exit_status = 2


class InfrastructureError(Exception):
    """A target, a tool or the network failed; the user's request may be right."""

    exit_status = 3
