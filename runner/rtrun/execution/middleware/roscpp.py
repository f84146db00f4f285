"""roscpp: its programs need a ROS master, which also knows who has subscribed."""

from rtrun.execution.middleware import ros_master
from rtrun.execution.middleware.service import Service
from rtrun.targets.link import Link

TOPIC = "/communication_tests"


def _identity(link: Link) -> str | None:
    pid = ros_master.ask_pid(link)
    return None if pid is None else str(pid)


SERVICE = Service(
    name="the ROS master",
    running=ros_master.running,
    identity=_identity,
    count_subscribers=lambda link, token: ros_master.count_subscribers(link, TOPIC, token),
)
