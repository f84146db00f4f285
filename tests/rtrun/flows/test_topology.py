"""Paths through tables of activations, held against a graph that is played message by message."""

import itertools
import random
from dataclasses import replace

import numpy as np
import pytest

from rtfiles.errors import UsageError
from rtrun.flows.topology.chains import ages, origins, reactions, stages, unanswered
from rtrun.flows.topology.fates import fates
from rtrun.flows.topology.late import late_path
from rtrun.flows.topology.streams import topology_streams
from rtrun.flows.topology.tables import NONE, HopTable, NodeTable, TopologyTables
from rtrun.kinds.path import STREAM as PATH
from rtrun.plan.topology.planning import TopologyPlan
from rtrun.plan.topology.topology import Executor, NodePath, Topology, TopologyNode, TopologyTopic, Waits

MS = 1_000_000
UNTIL = 400 * MS


def graph(rules):
    """A chain of nodes, of which node i takes topic i - 1 and sends topic i; the last two share a thread."""
    names = [f"n{number}" for number in range(len(rules))]
    last = len(rules) - 1
    nodes = tuple(
        TopologyNode(
            name=name,
            executor="shared" if number >= last - 1 else name,
            waits=waits,
            period_ns=period_ms * MS,
            inputs=(f"/t{number - 1}",) if number else (),
            outputs=(f"/t{number}",) if number < last else (),
        )
        for number, (name, (waits, period_ms)) in enumerate(zip(names, rules, strict=True))
    )
    executors = tuple(Executor(name=name, process="all") for name in dict.fromkeys(node.executor for node in nodes))
    topics = tuple(TopologyTopic(name=f"/t{number}") for number in range(last))
    return Topology(name="chain", nodes=nodes, executors=executors, topics=topics)


def play(topology, seed):
    """Play it: tables as the programs would have written them, and of each activation the data that it knew."""
    draw = random.Random(seed)
    until, free = UNTIL, dict.fromkeys((executor.name for executor in topology.executors), 0)
    rows = {node.name: [] for node in topology.nodes}
    came = {node.name: [] for node in topology.nodes}  # seq, published, received, taken
    arrivals = {node.name: [] for node in topology.nodes}
    origin = {node.name: [] for node in topology.nodes}
    clock = 0
    while clock < until + 300 * MS:
        for place, node in enumerate(topology.nodes):
            ready = [arrival for arrival in arrivals[node.name] if arrival[2] <= clock]
            free_at = free[node.executor]
            due = len(rows[node.name]) * node.period_ns if node.period_ns else None
            if clock < free_at:
                continue
            for message in ready:
                arrivals[node.name].remove(message)
                came[node.name].append([*message[:2], clock, NONE])
                if node.waits is not Waits.PERIOD:
                    break
            released = (due is not None and due <= clock and due < until) or (node.waits is not Waits.PERIOD and ready)
            if not released:
                continue
            number = len(rows[node.name])
            taken, data = NONE, number if place == 0 else NONE
            if came[node.name]:
                newest = came[node.name][-1]
                newest[3] = number if newest[3] == NONE else newest[3]
                taken = newest[0]
                data = origin[topology.nodes[place - 1].name][taken]
            begin = clock
            done = begin + draw.randint(0, 4 * MS)
            end = done + draw.randint(1, MS)
            free[node.executor] = end
            release = due if due is not None else begin
            rows[node.name].append([release, begin, done, end, draw.randint(0, done - begin), taken])
            origin[node.name].append(data)
            if node.outputs and draw.random() > 0.2:
                taker = topology.nodes[place + 1].name
                arrivals[taker].append((number, done, end + draw.randint(0, 9 * MS)))
        clock += MS // 4
    return rows, came, origin


def tables_of(topology, rows, came, first_ns):
    nodes, hops = {}, []
    for node in topology.nodes:
        columns = np.array(rows[node.name], np.int64).reshape(-1, 6).T
        nodes[node.name] = NodeTable(
            name=node.name,
            release_ns=columns[0],
            begin_ns=columns[1],
            done_ns=columns[2],
            end_ns=columns[3],
            cpu_ns=columns[4],
            taken=(columns[5],) if node.inputs else (),
            first=int(np.searchsorted(columns[0], first_ns)),
            skipped=0,
        )
    for before, node in zip(topology.nodes, topology.nodes[1:], strict=False):
        columns = np.array(came[node.name], np.int64).reshape(-1, 4).T
        hops.append(
            HopTable(
                topic=node.inputs[0],
                publisher=before.name,
                subscriber=node.name,
                seq=columns[0],
                publication_ns=columns[1],
                reception_ns=columns[2],
                taken=columns[3],
                left_ns=10**15,
            )
        )
    return TopologyTables(topology=topology, until_ns=UNTIL, nodes=nodes, hops=tuple(hops), hosts={})


RULES = [
    [(Waits.PERIOD, 10), (Waits.ANY, 0), (Waits.ANY, 0), (Waits.ANY, 0)],
    [(Waits.PERIOD, 10), (Waits.PERIOD, 25), (Waits.ANY, 0)],
    [(Waits.PERIOD, 20), (Waits.ANY, 0), (Waits.PERIOD, 7), (Waits.PERIOD, 30)],
]


@pytest.mark.parametrize("rules", RULES)
@pytest.mark.parametrize("seed", range(5))
def test_reactions_and_ages_are_those_of_the_messages(rules, seed):
    topology = graph(rules)
    rows, came, origin = play(topology, seed)
    tables = tables_of(topology, rows, came, 50 * MS)
    (path,) = topology.all_paths()
    path_origins = origins(tables, path)
    sink, source = path.sink, path.nodes[0]
    assert path_origins[0].tolist() == origin[sink]
    first = tables.nodes[source].first
    expected = [
        (rows[source][data][0], rows[sink][number][3])
        for number, data in enumerate(origin[sink])
        if data != NONE and data >= first and number >= tables.nodes[sink].first
    ]
    age = ages(tables, path, path_origins[0])
    assert list(zip(age.begin_ns.tolist(), age.end_ns.tolist(), strict=True)) == expected
    expected = []
    for begun in range(first, len(rows[source])):
        answer = next((number for number, data in enumerate(origin[sink]) if data != NONE and data >= begun), None)
        if answer is not None:
            expected.append((rows[source][begun][0], rows[sink][answer][3]))
    reaction = reactions(tables, path, path_origins[0])
    assert list(zip(reaction.begin_ns.tolist(), reaction.end_ns.tolist(), strict=True)) == expected
    assert len(expected) > 5
    longest = max(end - begin for begin, end in expected)
    late = [row[0] for row in rows[source][first + len(expected) :] if row[0] < UNTIL - 2 * longest]
    assert unanswered(tables, path, reaction) == len(late)
    for activation in reaction.activation:
        walked = stages(tables, path, path_origins, int(activation))
        assert [stage.node.name for stage in walked] == list(path.nodes)
        for before, after in itertools.pairwise(walked):
            assert before.publication_ns <= before.reception_ns <= after.node.begin_ns[after.row]
    # The parts of reactions add up, whatever is late.
    for deadline_ns in (None, 1, 30 * MS):
        cut = late_path(tables, path, deadline_ns)
        lengths = reaction.end_ns - reaction.begin_ns
        late = lengths > cut.limit_ns if (lengths > cut.limit_ns).any() else lengths >= lengths.max()
        assert (cut.late, cut.reactions) == (late.sum(), lengths.size)
        assert sum(part.late_ns for part in cut.parts) == pytest.approx(lengths[late].mean())


@pytest.mark.parametrize("seed", range(5))
def test_every_message_has_one_fate(seed):
    topology = graph(RULES[2])
    rows, came, _ = play(topology, seed)
    tables = tables_of(topology, rows, came, 50 * MS)
    for hop in tables.hops:
        of_hop, publisher = fates(tables, hop), tables.nodes[hop.publisher]
        sent = range(publisher.first, publisher.release_ns.size)
        received = {seq: taken for seq, _, _, taken in came[hop.subscriber] if seq in sent}
        assert of_hop.sent == len(sent)
        assert of_hop.taken == sum(taken != NONE for taken in received.values())
        assert of_hop.on_the_way == len(sent) - len(received) > 0 and of_hop.too_late == 0
        assert of_hop.overwritten + of_hop.unused == len(received) - of_hop.taken
        assert sum(of_hop.lost.values()) == len(sent) - len(received)


@pytest.mark.parametrize(("died_at", "never"), [(30, 0), (29, 0), (28, 0), (27, 0), (26, 0), (25, 1), (10, 16)])
def test_what_was_never_reacted_to_counts_unless_the_run_ended_too_early_to_see_it(died_at, never):
    """Of 30 messages of a sensor, one each 10 ms, none reaches the actuator from one on; others take 20 ms."""
    topology = graph([(Waits.PERIOD, 10), (Waits.ANY, 0)])
    rows = {"n0": [[10 * MS * n] * 4 + [0, NONE] for n in range(30)], "n1": []}
    came = {"n0": [], "n1": [[n, 10 * MS * n, (10 * n + 20) * MS, n] for n in range(died_at)]}
    rows["n1"] = [[received] * 4 + [0, n] for n, _, received, _ in came["n1"]]
    tables = replace(tables_of(topology, rows, came, 0), until_ns=300 * MS)
    (path,) = topology.all_paths()
    plan = TopologyPlan(topology=topology, for_s=0.3, paths=(path,))
    (reaction,) = (stream for stream in topology_streams(tables, plan) if stream.kind is PATH)
    assert (reaction.columns["end_ns"].size, reaction.counts["lost"]) == (died_at, never)


def test_a_node_that_works_long_is_named():
    """Of thirty reactions one is late, and its second node is what made it so."""
    topology = graph([(Waits.PERIOD, 10), (Waits.ANY, 0), (Waits.ANY, 0)])
    # The second node works for 1 ms, once for 8 ms.
    rows = {"n0": [], "n1": [], "n2": []}
    came = {"n0": [], "n1": [], "n2": []}
    for number in range(30):
        at, long = number * 10 * MS, 8 * MS if number == 20 else MS
        rows["n0"].append([at, at, at, at, 0, NONE])
        came["n1"].append([number, at, at + MS, number])
        rows["n1"].append([at + MS, at + MS, at + MS + long, at + MS + long, long, number])
        came["n2"].append([number, at + MS + long, at + MS + long, number])
        rows["n2"].append([at + MS + long, at + MS + long, at + 2 * MS + long, at + 2 * MS + long, MS, number])
    cut = late_path(tables_of(topology, rows, came, 0), *topology.all_paths(), 5 * MS)
    assert (cut.late, cut.parts[0].what, cut.parts[0].extra_ns) == (1, "n1 works", 7 * MS)
    assert [cut.share(part) for part in cut.parts[:2]] == [1, 0]
    # Its response is told in the same way.
    response = late_path(tables_of(topology, rows, came, 0), NodePath(topics=(), nodes=("n1",)), 5 * MS)
    assert (response.late, response.limit_ns, [part.what for part in response.parts]) == (1, 5 * MS, ["n1 works"])


def test_what_a_target_cannot_have_measured_is_refused(tmp_path):
    from rtrun.flows.topology.tables import read_tables

    with pytest.raises(UsageError, match=r"process-all\.json"):
        read_tables(tmp_path, graph(RULES[1]))


def test_without_a_late_reaction_the_highest_percent_is_explained():
    topology = graph([(Waits.PERIOD, 10), (Waits.ANY, 0)])
    rows = {"n0": [[10 * MS * n] * 4 + [0, NONE] for n in range(400)], "n1": []}
    came = {"n0": [], "n1": [[n, 10 * MS * n, 10 * MS * n + MS + n, n] for n in range(400)]}
    rows["n1"] = [[received] * 4 + [0, n] for n, _, received, _ in came["n1"]]
    tables = replace(tables_of(topology, rows, came, 0), until_ns=5000 * MS)
    cut = late_path(tables, *topology.all_paths(), None)
    assert (cut.late, cut.reactions) == (4, 400)
