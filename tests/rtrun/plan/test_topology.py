"""Topology files: read, refused with what would be right, planned, and told to the processes of their nodes."""

import json
import re
from collections import Counter

import pytest

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.plan.campaign import read_campaign
from rtrun.plan.run import digest_of
from rtrun.plan.topology.node_text import process_text
from rtrun.plan.topology.rates import demands, rates_hz, shares
from rtrun.plan.topology.reading import read_topology
from rtrun.plan.topology.topology import Waits
from rtrun.report.topology_text import drawing

BRAKING = """
schema: 1
name: braking
common: {policy: FIFO, priority: 80}
nodes:
  lidar:   {period: 50ms, busy: 2ms, outputs: [/points], cpu: 0}
  imu:     {period: 10ms, offset: 1ms, outputs: [/imu], policy: 0}
  detect:  {inputs: [/points], busy: 15ms, outputs: [/objects], cpu: 0-1, priority: 60}
  fuse:    {inputs: [/objects, /imu], waits_for: all, busy: 500us, touches: 2MB, outputs: [/state], executor: control}
  control: {period: 10ms, inputs: [/state], busy: 1ms, outputs: [/cmd], deadline: 5ms, executor: control,
            process: brain}
  brake:   {inputs: [/cmd], busy: 100us}
topics:
  /points: {payload: 100kB, reliability: best_effort, depth: 1}
paths:
  - {topics: [/points, /objects, /state, /cmd], reaction: 120ms, age: 150ms}
"""
CAMPAIGN = "schema: 1\nname: test\ntopology: {}\nfor: 2s\n"
RUNS = "runs: [{middleware: [roscpp, rcl], condition: [idle, cpu80]}]\n"


def write(folder, text, name="graph.yml"):
    path = folder / name
    path.write_text(text)
    return path


def campaign(folder, text=RUNS, graph=BRAKING):
    return write(folder, CAMPAIGN.format(write(folder, graph).name) + text, "campaign.yml")


def nodes(*lines):
    return "schema: 1\nname: test\nnodes:\n" + "".join(f"  {line}\n" for line in lines)


def test_a_process_is_told_its_part_in_lines_of_words(tmp_path):
    _, runs = read_campaign(campaign(tmp_path))
    assert [run.name for run in runs] == [
        "001-topology-braking",
        "002-topology-braking-cpu80",
        "003-topology-braking-rcl",
        "004-topology-braking-rcl-cpu80",
    ]
    plan = runs[0].subject
    assert plan.topology.processes == ("lidar", "imu", "detect", "brain", "brake")
    assert process_text(plan, "brain").splitlines() == [
        "topology 1",
        "process brain 5",
        "measure 2500000000",
        "topic 0 /objects 0 reliable 10",
        "topic 1 /imu 0 reliable 10",
        "topic 2 /state 0 reliable 10",
        "topic 3 /cmd 0 reliable 10",
        "executor 0 control FIFO 80 -",
        "node 0 fuse 0 all 0 0 500000 2000000 50",
        "in 0 0 50",
        "in 0 1 250",
        "out 0 2 1 1",
        "node 1 control 0 period 10000000 0 1000000 0 250",
        "in 1 2 50",
        "out 1 3 1 1",
        "end",
    ]
    assert (
        "topic 0 /points 100000 best_effort 1\ntopic 1 /objects 0 reliable 10\nexecutor 0 detect FIFO 60 0-1\n"
        in process_text(plan, "detect")
    )
    assert "executor 0 imu 0 0 -\nnode 0 imu 0 period 10000000 1000000 0 0 250\n" in process_text(plan, "imu")


def test_deadlines_of_the_file_and_of_the_campaign_are_those_of_the_run(tmp_path):
    further = "deadlines: ['timer:/control=1ms', 'age:/imu,/state=7ms', /imu=2ms, 'response:/control=2ms']\n"
    further += "paths: ['/imu,/state,/cmd']\n"
    _, runs = read_campaign(campaign(tmp_path, further + RUNS))
    plan = runs[0].subject
    assert [deadline.text for deadline in plan.deadlines] == [
        "response:/control=2000000ns",  # 5 ms in the topology
        "path:/points,/objects,/state,/cmd=120000000ns",
        "age:/points,/objects,/state,/cmd=150000000ns",
        "timer:/control=1000000ns",
        "age:/imu,/state=7000000ns",
        "messages:/imu=2000000ns",
    ]
    assert [path.nodes for path in plan.paths] == [
        ("lidar", "detect", "fuse", "control", "brake"),
        ("imu", "fuse", "control", "brake"),
        ("imu", "fuse", "control"),
    ]
    # What is measured tells one campaign from another; an option at its default does not.
    texts = [BRAKING, BRAKING.replace("2ms", "3ms"), BRAKING + "may_overload: true\n"]
    assert len({digest_of(read_campaign(campaign(tmp_path, graph=text))[1]) for text in texts}) == 3
    assert (
        digest_of(read_campaign(campaign(tmp_path, graph=BRAKING + "may_overload: false\n"))[1])
        == digest_of(read_campaign(campaign(tmp_path))[1])
    )  # fmt: skip


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        (["a: {busy: 1ms}"], r"graph.yml:4: nodes.a: nothing activates it: give a period, inputs, or both"),
        (["a: {period: 1ms, outputs: [/x]}", "b: {inputs: [/y]}"], r":5: nodes.b.inputs.0: no node publishes /y,"),
        (
            ["a: {period: 1ms, outputs: [/points]}", "b: {inputs: [/ponts]}"],
            r"no node publishes /ponts, did you mean '/points'\? published: /points",
        ),
        (
            ["a: {period: 1ms, outputs: [/x]}", "b: {period: 1ms, outputs: [/x]}"],
            r":5: nodes.b.outputs.0: /x is published by a already: a topic has one publisher",
        ),
        (
            ["a: {inputs: [/y], outputs: [/x]}", "b: {inputs: [/x], outputs: [/y]}"],
            r"nodes.[ab]: (a -> b -> a|b -> a -> b) is a cycle in which no node has a period: .*give one of them a",
        ),
        (["a: {inputs: [/x], outputs: [/x]}"], r"nodes.a: a -> a is a cycle in which no node has a period"),
        (["a: {perod: 1ms}"], r":4: nodes.a: unknown key 'perod', did you mean 'period'\? allowed: .*busy"),
        (["a: {period: 5}"], r":4: nodes.a.period: '5' is no time above 0 with its unit"),
        (["a: {period: 1ms, outputs: [x]}"], r"nodes.a.outputs.0: 'x' is not the full name of a topic, .*as /scan"),
        (["a: {period: 1ms, outputs: [/" + "x" * 200 + "]}"], r"is not the full name of a topic, of at most 200 char"),
        ([f"n{number}: {{period: 1ms}}" for number in range(257)], r"nodes: takes 256 or fewer entries"),
        (["a-b: {period: 1ms}"], r"nodes.a-b: 'a-b' is not a name of at most 64 letters"),
        (["a: {period: 1ms, waits_for: al}"], r"nodes.a.waits_for: takes 'any' or 'all', got 'al'"),
        (
            ["a: {period: 1ms, inputs: [/x], outputs: [/x], waits_for: all}"],
            r"nodes.a.waits_for: leave it out: with a period it takes the newest of its inputs",
        ),
        (["a: {period: 1ms, offset: 1ms}"], r"nodes.a.offset: is the part of a period .*less than the period"),
        (["a: {period: 1ms, priority: 5}"], r"nodes.a.priority: takes policy FIFO or RR"),
        (["a: {period: 1ms, policy: FIFO, priority: 98}"], r"nodes.a.priority: takes a number up to 97, got 98"),
        (["a: {period: 1ms, policy: EDF}"], r"nodes.a.policy: takes '0', 'FIFO' or 'RR', got 'EDF'"),
        (["a: {period: 1ms, cpu: 3-1}"], r"nodes.a.cpu: '3-1' is no list of CPUs like 0-1,4"),
        (["a: {period: 1ms, touches: 1GB}"], r"nodes.a.touches: '1GB' is no size up to 256 MiB"),
        (["a: {period: 1ms, outputs: [/x, /x]}"], r"nodes.a.outputs.1: /x stands there twice"),
        (
            ["a: {period: 1ms, executor: e, cpu: 0}", "b: {period: 1ms, executor: e, cpu: 1}"],
            r":5: nodes.b.cpu: b and a share executor e, which is one thread: one cpu",
        ),
        (
            ["a: {period: 1ms, executor: e, process: p}", "b: {period: 1ms, executor: e, process: q}"],
            r":5: nodes.b.process: executor e is of process p already",
        ),
        (
            ["a: {period: 1ms, outputs: [/x]}", "b: {inputs: [/x]}", "#", "topics: {/y: {depth: 3}}"],
            r"topics./y: unknown topic '/y',.* published: /x",
        ),
        (
            ["a: {period: 1ms, outputs: [/x]}", "b: {inputs: [/x], outputs: [/y]}", "c: {inputs: [/y], outputs: [/z]}",
             "d: {inputs: [/z]}", "#", "paths: [{topics: [/x, /z]}]"],
            r"paths.0.topics: c, which sends /z, does not take /x; what leads there is /x,/y,/z",
        ),
        (
            ["a: {period: 1ms, outputs: [/x, /y]}", "b: {inputs: [/x]}", "#", "paths: [{topics: [/x, /y]}]"],
            r"paths.0.topics: a, which sends /y, does not take /x$",
        ),
    ],
)  # fmt: skip
def test_a_file_that_is_wrong_is_refused_with_what_would_be_right(tmp_path, lines, match):
    text = nodes(*lines).replace("  #\n  ", "")
    with pytest.raises(UsageError, match=match):
        read_topology(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("deadlines: ['timer:/brake=1ms']\n" + RUNS, r":5: deadlines.0: timer:/brake.*no node with a period is called"),
        ("deadlines: [/cnd=1ms]\n" + RUNS, r"deadlines.0: .*no node takes /cnd, taken are /points"),
        (
            "paths: ['/imu,/cmd']\n" + RUNS,
            r"paths.0: control, which sends /cmd, does not take /imu; .*/imu,/state,/cmd",
        ),
        ("runs: [{suite: cyclic_timer_tests}]\n", r"runs.0.suite: with topology nothing but that is measured"),
        ("runs: [{middleware: zeromq}]\n", r"runs.0.middleware: zeromq measures messages, and topology is of topology"),
        (
            "runs: [{repetitions: 3}]\n",
            r"runs.0: unknown key 'repetitions', a run with topology takes: other_nodes, rmw, domain_id, middleware",
        ),
        ("subject: attached\n" + RUNS, r"topology: a campaign has a subject or a topology, not both"),
    ],
)
def test_a_campaign_asks_for_what_its_topology_has(tmp_path, text, match):
    with pytest.raises(UsageError, match=match):
        read_campaign(campaign(tmp_path, text))


@pytest.mark.parametrize("lines", [
    ["a: {period: 1ns}"],
    # Each doubles what the one before sends.
    ["a0: {period: 1ms, outputs: [/x0, /y0]}",
     *(f"a{n}: {{inputs: [/x{n - 1}, /y{n - 1}], outputs: [/x{n}, /y{n}]}}" for n in range(1, 200))],
])  # fmt: skip
def test_what_is_activated_more_often_than_can_be_kept_is_refused(tmp_path, lines):
    with pytest.raises(UsageError, match=r"test would activate a.* more than 1 000 000 000 times in a run") as refused:
        read_campaign(campaign(tmp_path, graph=nodes(*lines)))
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("sink", ["", "sink: {inputs: [/t0]}"])
def test_a_graph_with_more_paths_than_can_be_looked_at_is_planned(tmp_path, sink, capsys):
    """Each of 24 nodes takes what all the others send: 10**23 ways lead through them, and none or many to an end."""
    dense = [f"n{node}: {{period: 10ms, inputs: [{', '.join(f'/t{peer}' for peer in range(24) if peer != node)}, /s], "
             f"outputs: [/t{node}]}}" for node in range(24)]  # fmt: skip
    path = campaign(tmp_path, graph=nodes("source: {period: 1ms, outputs: [/s]}", *dense, *filter(None, [sink])))
    assert main(["plan", str(path)]) == 0
    printed = capsys.readouterr().out
    assert ("no source leads to a sink" in printed) == (not sink)
    assert bool(re.search(r"these are the longest of \d+ found from source to sink", printed)) == bool(sink)
    paths = read_campaign(path)[1][0].subject.paths
    assert len(paths) == (32 if sink else 0) and all(
        len({*node_path.nodes}) == len(node_path.nodes) for node_path in paths
    )


def test_a_probe_sees_no_response(tmp_path):
    path = write(tmp_path, "schema: 1\nname: a\nsubject: attached\ndeadlines: ['response:/a=1ms']\nruns: [{}]\n")
    with pytest.raises(UsageError, match=r":4: deadlines.0: response: is of topologies: no probe sees it"):
        read_campaign(path)


def test_rates_follow_what_comes_and_shares_follow_rates(tmp_path):
    graph = nodes(
        "a: {period: 10ms, outputs: [/a], busy: 1ms}",
        "b: {period: 40ms, outputs: [/b]}",
        "either: {inputs: [/a, /b], outputs: [/e], busy: 2ms}",
        "both: {inputs: [/a, /b], waits_for: all, busy: 4ms}",
        "newest: {period: 20ms, inputs: [/e], outputs: [/n]}",
    )
    topology = read_topology(write(tmp_path, graph)).topology
    assert rates_hz(topology) == pytest.approx({"a": 100, "b": 25, "either": 125, "both": 25, "newest": 50})
    assert shares(topology) == pytest.approx({"a": 0.1, "b": 0, "either": 0.25, "both": 0.1, "newest": 0})
    assert [(demand.cpus, round(demand.share, 3)) for demand in demands(topology)] == [((), 0.45)]


# Each asks one of its CPUs for more than it has: one thread, one CPU of two threads, two CPUs of three, 0-1 with 1-2.
TOO_MUCH = [
    ([("a", 11, None)], "executor a: one thread is asked for 110 % of a CPU: a 110 %"),
    ([("a", 6, "1"), ("b", 5, "1")], "CPU 1: asked for 110 % of a CPU: a 60 %, b 50 %"),
    ([("a", 7, "0-1"), ("b", 7, "0-1"), ("c", 7, "0")], "CPUs 0-1: asked for 210 % of a CPU"),
    ([("a", 9, "0-1"), ("b", 9, "0-1"), ("c", 8, "1-2"), ("d", 8, "2")], "CPUs 0-2: asked for 340 % of a CPU"),
]


@pytest.mark.parametrize(("asked", "match"), TOO_MUCH)
def test_what_asks_a_cpu_for_more_than_it_has_is_refused_unless_the_file_says_otherwise(tmp_path, asked, match):
    def graph(less):
        return nodes(
            *(
                f"{name}: {{period: 10ms, busy: {round(1000 * busy * (1 - less))}us{f', cpu: {cpu}' if cpu else ''}}}"
                for name, busy, cpu in asked
            )
        )

    with pytest.raises(
        UsageError, match=f"graph.yml: {re.escape(match)}.*; may_overload: true measures it all the same"
    ):
        read_topology(write(tmp_path, graph(0)))
    assert read_topology(write(tmp_path, graph(0) + "may_overload: true\n")).topology.may_overload
    assert read_topology(write(tmp_path, graph(0.15))).topology.nodes, "what fits is taken"


def arrows(topology):
    return Counter((node.name, topic, taker.name) for node in topology.nodes for topic in node.outputs
                   for taker in topology.takers[topic])  # fmt: skip


def drawn(topology):
    """The arrows of a drawing, read back."""
    text = re.sub(r"\n {4}(?=─)", " ", "\n".join(drawing(topology)))
    found = Counter()
    for line in text.splitlines():
        first, *rest = re.split(r" ─(\S+)→ ", line)
        for topic, taker in zip(rest[::2], rest[1::2], strict=True):
            found[first, topic, taker] += 1
            first = taker
    return found


def test_plan_draws_each_arrow_once_and_says_what_each_cpu_is_asked_for(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    assert main(["plan", str(campaign(tmp_path))]) == 0
    printed = capsys.readouterr().out
    assert "lidar ─/points→ detect ─/objects→ fuse ─/state→ control ─/cmd→ brake\nimu ─/imu→ fuse\n" in printed
    assert re.search(
        r"^fuse +on /objects and /imu, 20/s +500 us, touches 2 MB +1 % +brain/control, FIFO 80", printed, re.M
    )
    assert re.search(r"^control +every 10 ms, newest of /state ", printed, re.M)
    assert "CPU 0: 4 % of a CPU asked for: lidar\nCPUs 0-1: 30 % of a CPU asked for: detect\nany CPU: 12 %" in printed
    assert "path lidar > detect > fuse > control > brake: reaction 120 ms, age 150 ms\n" in printed
    assert drawn(read_topology(tmp_path / "graph.yml").topology) == arrows(
        read_topology(tmp_path / "graph.yml").topology
    )
    assert main(["plan", "--json", str(campaign(tmp_path))]) == 0
    assert json.loads(capsys.readouterr().out)["runs"][0]["topology"]["topology"]["nodes"][0]["busy_ns"] == 2_000_000


# In the format of irobot-ros/ros2-performance, with each thing that it may have and that has no counterpart.
OTHERS = {
    "nodes": [
        {
            "node_name": "camera",
            "executor_id": 1,
            "publishers": [
                {"topic_name": "image", "msg_type": "stamped_vector", "msg_size": 5000, "freq_hz": 64,
                 "qos_reliability": "best_effort", "qos_depth": 3, "msg_pass_by": "shared_ptr"},
                {"topic_name": "health", "msg_type": "irobot_interfaces_plugin::stamped4_int32", "period_ms": 500},
            ],
            "subscribers": 2 * [{"topic_name": "tick", "msg_type": "stamped250kb"}],
        },
        {
            "node_name": "watcher",
            "number": 2,
            "node_namespace": "/far",
            "subscribers": [{"topic_name": "image", "msg_type": "stamped_vector", "qos_durability": "transient_local"}],
            "servers": [{"service_name": "reset", "srv_type": "stamped10b"}],
        },
        {
            "node_name": "clock",
            "publishers": [{"topic_name": "tick", "msg_type": "stamped250kb", "period_ms": 1.5}],
            "clients": [{"service_name": "reset", "srv_type": "stamped10b", "period_ms": 10}],
        },
    ]
}  # fmt: skip


def test_a_graph_of_others_is_read_and_what_has_no_counterpart_is_said(tmp_path):
    read = read_topology(write(tmp_path, json.dumps(OTHERS), "others.json"))
    topology = read.topology
    seen = [
        (node.name, node.executor, node.waits, node.period_ns, node.inputs, node.outputs) for node in topology.nodes
    ]
    assert seen == [
        ("camera", "executor1", Waits.PERIOD, 15_625_000, ("/tick",), ("/image",)),
        ("camera_500ms", "executor1", Waits.PERIOD, 500_000_000, (), ("/health",)),
        ("watcher_1", "executor0", Waits.ANY, 0, ("/image",), ()),
        ("watcher_2", "executor0", Waits.ANY, 0, ("/image",), ()),
        ("clock", "executor0", Waits.PERIOD, 1_500_000, (), ("/tick",)),
    ]
    sizes = {topic.name: (topic.payload_bytes, topic.reliability, topic.depth) for topic in topology.topics}
    assert sizes == {
        "/image": (5000, "best_effort", 3),
        "/health": (16, "reliable", 10),
        "/tick": (250 * 1024, "reliable", 10),
    }
    assert topology.processes == ("others",)
    remarks = "\n".join(read.remarks)
    for part in (
        "in one executor, of which that of the shortest period takes the inputs: camera (15625us, 500ms)",
        "a node takes a topic once: further subscriptions of camera /tick",
        "clients: 1: clock reset",
        "servers: 2: watcher_1 reset, watcher_2 reset",
        "node_namespace of watcher_1, watcher_2",
        "qos_durability transient_local, 2 times: watcher_1 /image, watcher_2 /image",
        "msg_pass_by shared_ptr, 1 times: camera /image",
        "others at the subscribers watcher_1 /image, watcher_2 /image",
    ):
        assert part in remarks


X = {"topic_name": "x", "msg_type": "stamped10b"}


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"publishers": [X]}, "publishers.0: nothing would send it: give period_ms"),
        ({"publishers": [{**X, "msg_type": "string"}]}, "msg_type: unknown type 'string', takes stamped10b"),
        ({"publishers": [{**X, "msg_type": f"stamped{'9' * 5000}b"}]}, "msg_type: unknown type 'stamped999"),
        ({"publishers": [{**X, "msg_type": "stamped300mb", "freq_hz": 1}]}, "stamped300mb: takes 256 MiB at most"),
        ({"publishers": [{**X, "freq_hz": 1e-320}]}, "freq_hz: takes a number from 0.0001 up"),
        ({"publishers": [{**X, "period_ms": 0.0001}]}, "period_ms: takes a number from 0.001 up"),
        ({"publishers": 2 * [{**X, "freq_hz": 1}]}, "publishers.1: /x stands there twice: a topic has one publisher"),
        ({"publishers": [{**X, "freq_hz": 1}], "number": 256}, "/x is published by a_1 already"),
        ({"publishers": [{**X, "freq_hz": number + 1} for number in range(257)]}, "they stand for 257 nodes here"),
        ({"subscribers": [X]}, "inputs.0: no node publishes /x, nor anything"),
        ({"publisher": []}, "nodes.0: unknown key 'publisher', did you mean 'publishers'"),
        ({"servers": [{"service_name": "x", "srv_type": "y"}]}, "services have no counterpart: nothing is left"),
    ],
)  # fmt: skip
def test_a_graph_of_others_that_cannot_run_is_refused(tmp_path, change, match):
    with pytest.raises(UsageError, match=re.escape(match)):
        read_topology(write(tmp_path, json.dumps({"nodes": [{"node_name": "a", **change}]}), "others.json"))
