"""Single messages and callbacks of an observation, to draw them."""

from typing import NamedTuple

from rtrun.flows.messages import Publication, Reception


class DrawnMessage(NamedTuple):
    """A message that was received: where and when it was published and received."""

    topic: str
    from_pid: int
    from_tid: int
    from_cpu: int
    publication_ns: int
    to_pid: int
    to_tid: int
    to_cpu: int
    reception_ns: int


class DrawnCallback(NamedTuple):
    """A call of a callback; `name` is its topic or timer."""

    name: str
    pid: int
    tid: int
    cpu: int
    begin_ns: int
    end_ns: int


class FlowRecorder:
    """Keeps the first `limit` messages and callbacks together, and counts the others."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.messages: list[DrawnMessage] = []
        self.callbacks: list[DrawnCallback] = []
        self.left_out = 0

    @property
    def _is_full(self) -> bool:
        if len(self.messages) + len(self.callbacks) < self.limit:
            return False
        self.left_out += 1
        return True

    def message(self, publication: Publication, reception: Reception) -> None:
        if not self._is_full:
            sender, receiver = publication.endpoint, reception.endpoint
            self.messages.append(
                DrawnMessage(
                    sender.topic, sender.process.pid, publication.tid, publication.cpu, publication.at_ns,
                    receiver.process.pid, reception.tid, reception.cpu, reception.at_ns,
                )
            )  # fmt: skip

    def callback(self, name: str, pid: int, tid: int, cpu: int, begin_ns: int, end_ns: int) -> None:
        if not self._is_full:
            self.callbacks.append(DrawnCallback(name, pid, tid, cpu, begin_ns, end_ns))
