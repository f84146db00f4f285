"""What can go wrong with a target, classified by what the caller can do about it."""

from rtfiles.errors import InfrastructureError


class TargetError(InfrastructureError):
    """The target cannot be used: refused, wrong host key, no ROS, no space. Trying again changes nothing."""


class ConnectionLost(TargetError):
    """The connection broke; programs on the target may continue. A new connection may succeed."""


class TargetGone(TargetError):
    """The board was switched off or its emulator ended."""


class DeadlineExpired(TargetError):
    """A remote command exceeded its time; everything that it started has been ended."""
