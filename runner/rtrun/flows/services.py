"""Calls of services: each request from when it was sent until its answer was taken.

From Kilted on the number of a request is seen where it is sent, where it is taken and where its answer is taken.
Before, only the answer shows it, and the client's next request. So there a request was taken when the thread that
answers it last looked for one, and a client takes an answer at its first look after that was sent, if only one was.
"""

from collections.abc import Callable
from itertools import chain, islice
from typing import TypeVar

from rtrun.flows.observation_state import FAULT, ObservationState
from rtrun.flows.programs import NAME_CHARACTERS_MAX, HandleTable, LivingProcess
from rtrun.flows.requests import CLIENTS, OPEN_MAX, SERVERS, Client, Key, Request, Server, ServicePair
from rtrun.flows.threads import ObservedThread
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.probes.hits import Hit

T = TypeVar("T", Client, Server)


class ServiceRecord:
    """The clients and servers of an observation, and the requests between them."""

    def __init__(self, state: ObservationState) -> None:
        self.pairs: dict[tuple[str, str, str], ServicePair] = {}
        """By service, and the labels of client and server."""
        self.handlers: dict[str, Callable[[Hit, ObservedThread], None]] = {
            "client_init": lambda hit, thread: self._init(hit, thread, CLIENTS, Client),
            "service_init": lambda hit, thread: self._init(hit, thread, SERVERS, Server),
            "request_send": self._send,
            "request_number": self._number,
            "request_take": self._take,
            "response_send": self._answer,
            "response_take": self._take_answer,
        }
        self._state = state
        self._of_service: dict[str, list[Client]] = {}
        self._by_key: dict[Key, Client] = {}

    def expire(self) -> None:
        """Forget clients that have ended."""
        alive = {name: [client for client in known if client.is_alive] for name, known in self._of_service.items()}
        self._of_service = {name: clients for name, clients in alive.items() if clients}
        self._by_key = {key: client for key, client in self._by_key.items() if client.is_alive}

    # What happens to a request, in this order.

    def _send(self, hit: Hit, thread: ObservedThread) -> None:
        client = self._known(hit, thread.process, CLIENTS, Client)
        if client is None:
            return
        client.enter(self._state.epoch)
        if client.key is None and (key := _key(hit)) is not None:
            client.key = key
            self._by_key[key] = client
        before = hit.values.get("before")
        thread.request = Request(client, hit.at_ns, before if isinstance(before, int) else -1)
        client.send(thread.request)
        if len(client.open) > OPEN_MAX:
            request = next(iter(client.open))
            del client.open[request]
            if (pair := client.pair or self._pair(client, request)) is not None:
                pair.lost += 1

    def _number(self, hit: Hit, thread: ObservedThread) -> None:
        request, number = thread.request, hit.values.get("number")
        thread.request = None
        if request is not None and isinstance(number, int):
            request.number = number

    def _take(self, hit: Hit, thread: ObservedThread) -> None:
        thread.does_other_work()
        server = self._known(hit, thread.process, SERVERS, Server) if hit.values.get("taken", 1) else None
        if server is None:
            return
        if "number" not in hit.values:
            thread.took = server, hit.at_ns
        elif (request := self._request(hit, server)) is not None and request.server is None:
            request.server, request.taken_ns = server, hit.at_ns

    def _answer(self, hit: Hit, thread: ObservedThread) -> None:
        took, thread.took = thread.took, None
        server = self._known(hit, thread.process, SERVERS, Server)
        request = self._request(hit, server) if server is not None else None
        if server is None or request is None or request.answered_ns != NOT_SEEN_NS:
            return
        if request.server is not server:
            is_taken = took is not None and took[0] is server and took[1] >= request.sent_ns
            request.server, request.taken_ns = server, took[1] if took is not None and is_taken else NOT_SEEN_NS
        request.answered_ns = hit.at_ns
        request.client.answered.append(request)

    def _take_answer(self, hit: Hit, thread: ObservedThread) -> None:
        thread.does_other_work()
        client = self._known(hit, thread.process, CLIENTS, Client) if hit.values.get("taken", 1) else None
        if client is None:
            return
        client.enter(self._state.epoch)
        number = hit.values.get("number")
        request = client.numbered(number) if isinstance(number, int) else client.next_answered(hit.at_ns)
        if client.pair is not None and client.unclear:
            client.pair.unclear += client.unclear
            client.unclear = 0
        if request is None:
            return
        del client.open[request]
        client.longest_ns = max(client.longest_ns, hit.at_ns - request.sent_ns)
        client.pair = self._pair(client, request)
        if client.pair is not None:
            client.pair.rows.add((request.sent_ns, hit.at_ns, request.taken_ns, request.answered_ns))

    def waiting(self, until_ns: int, least_ns: int) -> dict[ServicePair, list[int]]:
        """How long living clients have waited for answers, if for longer than ever before and than this; oldest first.

        A request that no server took counts for the server that answered the client last, if one did.
        """
        found: dict[ServicePair, list[int]] = {}
        for client in chain.from_iterable(self._of_service.values()):
            if not client.is_alive or client.epoch != self._state.epoch:
                continue
            for request in client.open:
                waited_ns = until_ns - request.sent_ns
                if waited_ns <= max(least_ns, client.longest_ns):
                    break
                pair = client.pair if request.server is None else None
                pair = pair or self._pair(client, request)
                if pair is not None:
                    found.setdefault(pair, []).append(waited_ns)
        return found

    def _pair(self, client: Client, request: Request) -> ServicePair | None:
        """The pair that a request is of; None if there is no room for another one."""
        key = client.service, client.label, "" if request.server is None else request.server.label
        pair = self.pairs.get(key)
        if pair is None and self._state.add_stream():
            pair = self.pairs[key] = ServicePair(*key, self._state.store)
        return pair

    def _request(self, hit: Hit, server: Server) -> Request | None:
        """The request that a server takes or answers; None if that is not known."""
        key, number = _key(hit), hit.values.get("number")
        client = self._by_key.get(key) if key is not None else None
        if key is not None and client is None:
            # Of some middlewares it cannot be read how a client is named: an only one is the one.
            alike = [*islice((known for known in self._of_service.get(server.service, ()) if known.is_alive), 2)]
            if len(alike) == 1 and alike[0].key is None:
                client = self._by_key[key] = alike[0]
        if client is None or not client.is_alive or not isinstance(number, int):
            return None
        client.enter(self._state.epoch)
        return client.numbered(number)

    # Clients and servers.

    def _init(self, hit: Hit, thread: ObservedThread, table: HandleTable[T], make: Callable[..., T]) -> None:
        thread.does_other_work()
        self._add(hit, thread.process, table, make)

    def _known(self, hit: Hit, process: LivingProcess, table: HandleTable[T], make: Callable[..., T]) -> T | None:
        known = table.table_of(process).get(hit.values.get("endpoint", ""))
        if known is not None and known.service == hit.values.get("service"):
            return known
        return self._add(hit, process, table, make)

    def _add(self, hit: Hit, process: LivingProcess, table: HandleTable[T], make: Callable[..., T]) -> T | None:
        things, state = table.table_of(process), self._state
        handle, service = hit.values.get("endpoint"), hit.values.get("service")
        if (
            handle is None
            or not isinstance(service, str)
            or service in ("", FAULT)
            or len(service) > NAME_CHARACTERS_MAX
        ):
            state.unreadable += 1
            return None
        if not state.has_room(handle, things):
            return None
        if handle in things:
            things[handle].is_replaced = True
        thing = things[handle] = make(process, service)
        thing.label = state.label_of(thing, hit.values.get("node"), (make.__name__, service))
        if isinstance(thing, Client):
            self._of_service.setdefault(service, []).append(thing)
        return thing


def _key(hit: Hit) -> Key | None:
    gid0, gid1 = hit.values.get("gid0"), hit.values.get("gid1")
    return (gid0, gid1) if isinstance(gid0, int) and isinstance(gid1, int) and gid0 else None
