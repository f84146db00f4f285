"""A made-up system of programs whose messages are known one by one, and the hits that probes would see of it."""

import random
from collections import defaultdict
from dataclasses import dataclass, field

from rtrun.flows.accumulator import HORIZON_NS, FlowAccumulator
from rtrun.probes.hits import Gap, GapCause, Hit, ObservedProgram, ProgramThread

MS = 10**6
S = 10**9
BEGIN_NS = 5_000 * S
WALL_NS = 1_700_000_000 * S


def program(pid, argv=("/opt/lib/talker",), start_ticks=100, threads=(), libraries=()):
    return ObservedProgram(
        pid=pid,
        start_ticks=start_ticks,
        name="comm",
        argv=tuple(argv),
        locked_bytes=0,
        libraries=libraries,
        threads=tuple(
            ProgramThread(tid=tid, name=name, policy="OTHER", priority=0, cpus=(0,)) for tid, name in threads
        ),
    )


def node(pid, name, **facts):
    return program(pid, ("/opt/lib/node", "--ros-args", "-r", f"__node:={name}"), **facts)


def hit(at_ns, event, *, pid=1, tid=None, cpu=0, **values):
    return Hit(at_ns, cpu, pid, pid if tid is None else tid, event, values)


def publish(at_ns, topic="/a", *, pid=1, endpoint=0xA0, stamp=None, tid=None):
    stamp = at_ns + WALL_NS if stamp is None else stamp
    return hit(at_ns, "publish", pid=pid, tid=tid, endpoint=endpoint, topic=topic, source_ns=stamp)


def take(at_ns, stamp_at_ns, topic="/a", *, pid=2, endpoint=0xB0, taken=1, tid=None):
    stamp = stamp_at_ns + WALL_NS
    return hit(at_ns, "take", pid=pid, tid=tid, endpoint=endpoint, topic=topic, source_ns=stamp, taken=taken)


def publish_bytes(at_ns, payload, topic="/a", *, pid=1, endpoint=0xA0, tid=None):
    key0, key1, size = payload
    values = {"key0": key0, "key1": key1, "size": size}
    return hit(at_ns, "publish", pid=pid, tid=tid, endpoint=endpoint, topic=topic, **values)


def take_bytes(at_ns, payload, topic="/a", *, pid=2, endpoint=0xB0, tid=None):
    key0, key1, size = payload
    return hit(
        at_ns, "take", pid=pid, tid=tid, endpoint=endpoint, topic=topic, key0=key0, key1=key1, size=size, taken=1
    )


@dataclass
class Truth:
    """Of each pair of labels: when each message was published, and when it was taken, both within the observation."""

    published: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    taken: dict[tuple[str, str], dict[int, list[int]]] = field(
        default_factory=lambda: defaultdict(lambda: defaultdict(list))
    )
    takes: dict[str, int] = field(default_factory=lambda: defaultdict(int))


@dataclass
class Life:
    """A program from one time to another; after a restart the next one has the same label."""

    label: str
    pid: int
    from_ns: int
    until_ns: int
    start_ticks: int
    publishes: bool
    period_ns: int = 10 * MS
    payloads: int = 0
    """How many different payloads it publishes; 0: each has its stamp."""


@dataclass
class System:
    """Publishers and subscribers of one topic, over a transport that loses, doubles, delays and reorders."""

    lives: list[Life]
    seed: int = 0
    loss: float = 0.0
    doubled: float = 0.0
    slow: float = 0.0
    """The share of messages that take half a second."""
    is_ordered: bool = False
    latency_ns: int = MS
    stamp_error_ns: int = 0
    until_ns: int = BEGIN_NS + 20 * S

    def hits(self):
        """All hits in order of time, those before the begin too, each with the truth of a message."""
        chance = random.Random(self.seed)
        used = set()

        def at(time_ns):
            while time_ns in used:
                time_ns += 1
            used.add(time_ns)
            return time_ns

        hits = []
        newest = {}
        for sender in (life for life in self.lives if life.publishes):
            time_ns = sender.from_ns + chance.randrange(sender.period_ns)
            while time_ns < sender.until_ns:
                published_ns = at(time_ns)
                payload = (chance.randrange(sender.payloads), 7, 16) if sender.payloads else None
                sent = publish_bytes(published_ns, payload, pid=sender.pid) if payload else None
                sent = sent or publish(published_ns, pid=sender.pid)
                hits.append((sent, sender, published_ns, None))
                for receiver in (life for life in self.lives if not life.publishes):
                    if chance.random() < self.loss:
                        continue
                    for _ in range(1 + (chance.random() < self.doubled)):
                        delay_ns = round(self.latency_ns * chance.lognormvariate(0, 0.6))
                        delay_ns += 500 * MS * (chance.random() < self.slow)
                        taken_ns = published_ns + delay_ns + 1
                        if self.is_ordered:
                            pair = sender.label, sender.pid, receiver.label
                            taken_ns = newest[pair] = max(taken_ns, newest.get(pair, 0) + 1)
                        if not receiver.from_ns <= taken_ns < receiver.until_ns:
                            continue
                        taken_ns = at(taken_ns)
                        if self.is_ordered:
                            newest[pair] = taken_ns
                        error = chance.randint(-self.stamp_error_ns, self.stamp_error_ns)
                        got = take_bytes(taken_ns, payload, pid=receiver.pid) if payload else None
                        got = got or take(taken_ns, published_ns + error, pid=receiver.pid)
                        hits.append((got, sender, published_ns, receiver))
                time_ns += round(sender.period_ns * chance.uniform(0.5, 1.5))
        return sorted((entry for entry in hits if entry[0].at_ns < self.until_ns), key=lambda entry: entry[0].at_ns)

    def observe(self, gaps=(), begin_ns=BEGIN_NS, horizon_ns=HORIZON_NS, chunk_ns=S):
        """An accumulator that saw it, and the truth about what it could see."""
        observed = FlowAccumulator(begin_ns=begin_ns, horizon_ns=horizon_ns)
        truth = Truth()
        chunks = defaultdict(list)
        for event, sender, published_ns, receiver in self.hits():
            if event.at_ns < begin_ns or any(gap.from_ns <= event.at_ns < gap.until_ns for gap in gaps):
                continue
            chunks[event.at_ns // chunk_ns].append(event)
            if receiver is None:
                truth.published[sender.label].append(published_ns)
            else:
                truth.taken[sender.label, receiver.label][published_ns].append(event.at_ns)
                truth.takes[receiver.label] += 1
        for gap in gaps:
            chunks[gap.from_ns // chunk_ns].append(gap)
        for number in sorted(chunks):
            observed.observe(self._listed(number * chunk_ns, (number + 1) * chunk_ns))
            observed.feed(chunks[number])
        observed.finish()
        return observed, truth

    def _listed(self, from_ns, until_ns):
        """The programs that live at some time in a chunk, the last one of each pid."""
        living = [life for life in self.lives if life.from_ns < until_ns and life.until_ns > from_ns]
        return [node(life.pid, life.label.strip("/"), start_ticks=life.start_ticks) for life in living]


def talker(label="/talker", pid=1, from_ns=BEGIN_NS - 5 * S, until_ns=BEGIN_NS + 30 * S, start_ticks=100, **facts):
    return Life(label, pid, from_ns, until_ns, start_ticks, True, **facts)


def listener(label="/listener", pid=2, from_ns=BEGIN_NS - 5 * S, until_ns=BEGIN_NS + 30 * S, start_ticks=100):
    return Life(label, pid, from_ns, until_ns, start_ticks, False)


def gap(from_s, until_s):
    from_ns, until_ns = (BEGIN_NS + round(at_s * S) for at_s in (from_s, until_s))
    return Gap(from_ns, until_ns, "the kernel lost events", GapCause.EVENTS_LOST)
