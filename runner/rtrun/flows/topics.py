"""Both ends of each topic, from the hits of publishing and taking, and names for publishers and subscribers."""

from collections.abc import Callable, Mapping

from rtrun.flows.matching import PayloadMatching, StampMatching, has_header
from rtrun.flows.messages import (
    PUBLISHERS,
    SUBSCRIBERS,
    SUBSCRIPTIONS,
    TAKERS_MAX,
    End,
    Endpoint,
    MessageRecord,
    Payload,
    Publication,
    Reception,
)
from rtrun.flows.observation_state import FAULT, ObservationState
from rtrun.flows.paths import PathRecord
from rtrun.flows.programs import NAME_CHARACTERS_MAX, Handle, LivingProcess, full_name
from rtrun.flows.recorder import FlowRecorder
from rtrun.flows.threads import ObservedThread
from rtrun.probes.hits import Hit

PUBLISHER, SUBSCRIBER = "publisher", "subscriber"
# Topics of ROS 2 itself, in every process: not messages between nodes.
_OF_ROS = frozenset(("ros_discovery_info", "/parameter_events"))
# The states in which a node of lifecycle stops, by their labels in rcl_lifecycle.
_LEAVING = ("deactivating", "shuttingdown", "errorprocessing")
_KEY_BYTES = 12
_OPEN_MAX = 100_000  #: observed messages that wait to be taken
_HORIZON_LEAST_NS = 10**6


class TopicRecord(MessageRecord):
    """The publishers and subscribers of an observation, and their messages."""

    def __init__(
        self, state: ObservationState, paths: PathRecord, horizon_ns: int, recorder: FlowRecorder | None
    ) -> None:
        super().__init__(state)
        self.ends: dict[tuple[str, str, str], End] = {}
        """By role, topic and label."""
        self.handlers: dict[str, Callable[[Hit, ObservedThread], None]] = {
            "publish": self._publish,
            "take": self._take,
            "node_init": self._init_node,
            "publisher_init": lambda hit, thread: self._init(
                hit, thread, PUBLISHER, PUBLISHERS.table_of(thread.process)
            ),
            "subscription_init": self._init_subscription,
            "lifecycle": self._change_state,
        }
        self._state = state
        self._paths = paths
        self._horizon_ns = horizon_ns
        self._recorder = recorder
        self._by_stamp: dict[str, StampMatching] = {}
        self._by_bytes: dict[str, PayloadMatching] = {}

    def expire(self, now_ns: int) -> None:
        """Forget publications that are too old."""
        matchings, horizon_ns = self._matchings(), self._horizon_ns
        while True:
            for matching in matchings:
                matching.expire(now_ns + self._horizon_ns - horizon_ns)
            # Takers are halved, so that this is not done again for the next message.
            if sum(matching.open for matching in matchings) <= _OPEN_MAX and self.takers <= TAKERS_MAX // 2:
                return
            # More messages than a system publishes within the horizon at the highest rate: remember fewer.
            horizon_ns //= 2
            if horizon_ns < _HORIZON_LEAST_NS:
                self.cut()
                return

    def cut(self) -> None:
        """Hits are missing: decide what can be decided, and start afresh."""
        for matching in self._matchings():
            matching.cut()
        self.unlink()

    def clock_was_set(self) -> None:
        """The clock was set: earlier stamps belong to no later publication."""
        if any(matching.has_unstamped for matching in self._by_stamp.values()):
            self.cut()

    def told_apart_by(self, topic: str) -> str:
        """What distinguishes the messages of a topic, in words."""
        stamps = self._by_stamp.get(topic)
        by = [] if stamps is None else ["time of publication" if stamps.has_unstamped else "time stamp"]
        by += [f"first {_KEY_BYTES} bytes and length"] * (topic in self._by_bytes)
        return " or ".join(by)

    def _matchings(self) -> list[StampMatching | PayloadMatching]:
        return [*self._by_stamp.values(), *self._by_bytes.values()]

    def matched(self, reception: Reception, publication: Publication) -> None:
        super().matched(reception, publication)
        if self._recorder is not None:
            self._recorder.message(publication, reception)

    def _publish(self, hit: Hit, thread: ObservedThread) -> None:
        # Bytes without a size: roscpp passes the message on within its process, by pointer.
        if hit.values.get("topic") in _OF_ROS or ("key0" in hit.values and "size" not in hit.values):
            return
        key = key_of(hit.values)
        process = thread.process
        endpoint = self._endpoint_of(hit, process, PUBLISHER, PUBLISHERS.table_of(process))
        if endpoint is None:
            self._state.unreadable += 1
            return
        at_ns = hit.at_ns
        resumes = endpoint.end.paused_ns is not None
        index = endpoint.end.add(at_ns, endpoint, self._state.epoch)
        publication = Publication(endpoint, index, at_ns, hit.tid, hit.cpu)
        publication.resumes = resumes
        if self._paths.paths:
            self._paths.published(publication, thread.handled)
        if isinstance(key, int):
            self._stamped(endpoint.topic).publish(key, publication)
        elif key is not None:
            self._unstamped(endpoint.topic).publish(key, publication)
        else:
            # Humble and Iron do not show the stamp here: it lies between this and what the thread does next.
            self._stamped(endpoint.topic).publish_unstamped(publication)
            thread.published = publication

    def _take(self, hit: Hit, thread: ObservedThread) -> None:
        if not hit.values.get("taken", 1):
            thread.turns_to(None)
            return
        if hit.values.get("topic") in _OF_ROS:
            thread.does_other_work()
            return
        key = key_of(hit.values)
        process = thread.process
        endpoint = self._endpoint_of(hit, process, SUBSCRIBER, SUBSCRIBERS.table_of(process))
        if endpoint is None or key is None:
            self._state.unreadable += 1
            thread.does_other_work()
            return
        endpoint.end.add(hit.at_ns, endpoint, self._state.epoch)
        reception = Reception(endpoint, hit.at_ns, hit.tid, hit.cpu)
        if isinstance(key, int):
            self._stamped(endpoint.topic).receive(key, reception)
            thread.takes(reception)
            return
        # This is roscpp, where another thread calls back.
        self._unstamped(endpoint.topic).receive(key, reception)

    def _endpoint_of(
        self, hit: Hit, process: LivingProcess, role: str, known: dict[Handle, Endpoint]
    ) -> Endpoint | None:
        topic = hit.values.get("topic")
        if not isinstance(topic, str) or topic in ("", FAULT) or len(topic) > NAME_CHARACTERS_MAX:
            return None
        handle = hit.values.get("endpoint", topic)
        endpoint = known.get(handle)
        if endpoint is not None and endpoint.topic == topic:
            return endpoint
        return self._made(process, role, topic, handle, known)

    def _made(
        self,
        process: LivingProcess,
        role: str,
        topic: str,
        handle: Handle,
        known: dict[Handle, Endpoint],
        node: Handle | None = None,
        begin_ns: int | None = None,
    ) -> Endpoint | None:
        state = self._state
        if state.is_full or not state.has_room(handle, known):
            return None
        if handle in known:
            known[handle].is_replaced = True
        endpoint = known[handle] = Endpoint(process, topic, begin_ns)
        label = state.label_of(endpoint, node, (role, topic))
        end = self.ends.get((role, topic, label))
        if end is None:
            state.add_stream()
            end = self.ends[role, topic, label] = End(topic, label, state.store)
        endpoint.end = end
        return endpoint

    def _stamped(self, topic: str) -> StampMatching:
        matching = self._by_stamp.get(topic)
        if matching is None:
            matching = self._by_stamp[topic] = StampMatching(self, self._horizon_ns, self._state)
        return matching

    def _unstamped(self, topic: str) -> PayloadMatching:
        matching = self._by_bytes.get(topic)
        if matching is None:
            matching = PayloadMatching(self, self._horizon_ns, self._state)
            self._by_bytes[topic] = matching
        return matching

    def _init(self, hit: Hit, thread: ObservedThread, role: str, known: dict[Handle, Endpoint]) -> None:
        handle, topic = hit.values.get("endpoint"), hit.values.get("topic")
        thread.does_other_work()
        if handle is None or not isinstance(topic, str) or topic in ("", FAULT) or len(topic) > NAME_CHARACTERS_MAX:
            self._state.unreadable += 1
        else:
            self._made(thread.process, role, topic, handle, known, hit.values.get("node"), hit.at_ns)

    def _init_subscription(self, hit: Hit, thread: ObservedThread) -> None:
        process = thread.process
        subscribers, subscriptions = SUBSCRIBERS.table_of(process), SUBSCRIPTIONS.table_of(process)
        self._init(hit, thread, SUBSCRIBER, subscribers)
        handle, endpoint = hit.values.get("subscription"), subscribers.get(hit.values.get("endpoint", ""))
        if handle is not None and endpoint is not None and self._state.has_room(handle, subscriptions):
            subscriptions[handle] = endpoint

    def _change_state(self, hit: Hit, thread: ObservedThread) -> None:
        """A lifecycle node leaves a state. It is not known which node of the process this is: all publishers may be its
        own."""
        thread.does_other_work()
        if hit.values.get("before") in _LEAVING:
            for endpoint in PUBLISHERS.table_of(thread.process).values():
                if endpoint.is_alive:
                    endpoint.end.pause(hit.at_ns)

    def _init_node(self, hit: Hit, thread: ObservedThread) -> None:
        node, name, namespace = (hit.values.get(key, "") for key in ("node", "name", "namespace"))
        thread.does_other_work()
        if not node or not isinstance(name, str) or not isinstance(namespace, str) or name in ("", FAULT):
            self._state.unreadable += 1
            return
        if len(name) + len(namespace) > NAME_CHARACTERS_MAX:
            self._state.unreadable += 1
        elif self._state.has_room(node, thread.process.names_of_nodes):
            thread.process.names_of_nodes[node] = full_name(name, "" if namespace == FAULT else namespace)


def key_of(values: Mapping[str, int | str]) -> int | Payload | None:
    """What identifies a message: its source's time stamp, or its bytes; None if the hit has neither.

    Bytes that follow a short message in memory are masked out.
    """
    stamp = values.get("source_ns")
    if isinstance(stamp, int):
        return stamp
    key0, key1, size = values.get("key0"), values.get("key1"), values.get("size")
    if not isinstance(key0, int) or not isinstance(key1, int) or not isinstance(size, int) or size < 0:
        return None
    if size < _KEY_BYTES:
        return key0 & (1 << 8 * min(size, 8)) - 1, key1 & (1 << 8 * max(size - 8, 0)) - 1, size
    # In a message with a header, roscpp writes the number before the stamp only after the probe saw the publication.
    return (key0 >> 32 << 32 if has_header((key0, key1, size)) else key0), key1, size
