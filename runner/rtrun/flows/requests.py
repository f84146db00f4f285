"""Clients and servers of services, and the requests between them."""

from rtrun.flows.programs import HandleTable, LivingProcess, LivingThing
from rtrun.flows.rows import RowStore
from rtrun.kinds.messages import NOT_SEEN_NS

OPEN_MAX = 1000  #: requests of a client without an answer that are kept
_QUIET_NS = 10**8  # a client that has not looked for this long has taken what was there

Key = tuple[int, int]
"""What names a client in its requests and their answers, in all processes."""


class ServicePair:
    """The requests of a client that a server answered, over all restarts of both.

    `server` is empty if no server was seen. `rows`: when each was sent, when its answer was taken, when the server took
    it, and when that answered (NOT_SEEN_NS: not seen). `lost` are requests without an answer before the 1000 open ones.
    `unclear` counts those of which it is not known when, or whether, the client took their answer.
    """

    __slots__ = ("client", "lost", "rows", "server", "service", "unclear")

    def __init__(self, service: str, client: str, server: str, store: RowStore) -> None:
        self.service, self.client, self.server = service, client, server
        self.rows = store.rows(4)
        self.lost = self.unclear = 0


class Request:
    """A request. `above`: its number is above this one; `server` is the one that took or answered it first."""

    __slots__ = ("above", "answered_ns", "client", "number", "sent_ns", "server", "taken_ns")

    def __init__(self, client: "Client", sent_ns: int, above: int) -> None:
        self.client = client
        self.sent_ns = sent_ns
        self.above = above
        self.number: int | None = None
        self.server: Server | None = None
        self.taken_ns = self.answered_ns = NOT_SEEN_NS


class Server(LivingThing):
    """A server of a living process; `label` names its node."""

    __slots__ = ("label", "service")

    def __init__(self, process: LivingProcess, service: str) -> None:
        super().__init__(process)
        self.service = service
        self.label = ""


class Client(LivingThing):
    """A client of a living process; `label` names its node.

    `key` is what names it in its requests; None: that cannot be read. `open` are its requests whose answer it has not
    taken since the last gap, oldest first, `answered` those of them that were answered. `longest_ns` is how long it
    waited for an answer at most. `owed` is how many answers it may still take of those that are `unclear`.
    """

    __slots__ = (
        "answered", "epoch", "key", "label", "latest", "longest_ns", "looked_ns", "open", "owed", "pair", "service",
        "unclear",
    )  # fmt: skip

    def __init__(self, process: LivingProcess, service: str) -> None:
        super().__init__(process)
        self.service = service
        self.label = ""
        self.key: Key | None = None
        self.epoch = 0
        self.open: dict[Request, None] = {}
        self.answered: list[Request] = []
        self.latest: Request | None = None
        self.pair: ServicePair | None = None
        self.longest_ns = self.looked_ns = self.owed = self.unclear = 0

    def enter(self, epoch: int) -> None:
        """Forget what was sent before a gap: what became of it there is not known."""
        if self.epoch != epoch:
            self.epoch, self.latest = epoch, None
            self.open.clear()
            self.answered.clear()

    def send(self, request: Request) -> None:
        """It sends a request, which shows the number of the one before."""
        if self.latest is not None and self.latest.number is None and request.above > self.latest.above:
            self.latest.number = request.above
        self.latest = request
        self.open[request] = None

    def numbered(self, number: int) -> Request | None:
        """The open request of this number; None if that is not certain."""
        if (known := next((request for request in self.open if request.number == number), None)) is not None:
            return known
        others = [request for request in self.open if request.number is None and request.above < number]
        if len(others) != 1:
            return None
        others[0].number = number
        return others[0]

    def next_answered(self, at_ns: int) -> Request | None:
        """The only answered request whose answer it can take now; None if there is none, or if there are several.

        Which of several it takes is not known, nor whether it takes the others later: they are `unclear`.
        """
        pending = [request for request in self.answered if request in self.open]
        self.answered.clear()
        if at_ns - self.looked_ns > max(_QUIET_NS, 2 * self.longest_ns):
            self.owed = 0
        self.looked_ns = at_ns
        if len(pending) == 1 and not self.owed:
            return pending[0]
        self.owed = max(self.owed - 1, 0) if not pending else self.owed + len(pending) - 1
        for request in pending:
            del self.open[request]
            self.unclear += 1
        return None


CLIENTS, SERVERS = HandleTable[Client](), HandleTable[Server]()
