"""Calls of services, observed beside what clients and servers write down themselves."""

import contextlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from probes.standin import observed, running
from probes.test_real_programs import RELEASES, await_libraries, ros2_environment

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.streams import streams
from rtrun.kinds.service import STREAM as SERVICE
from rtrun.probes.programs import Roster
from rtrun.probes.session import Began

pytestmark = [pytest.mark.trace, pytest.mark.ros, pytest.mark.timeout(600)]
NODE = Path(__file__).with_name("service_node.py")
COUNT = 100


def watched(here, folder, environment, ahead):
    """What was seen of three clients of a service, two of which share a process; and what they and it have printed."""
    argv, batches = [sys.executable, NODE], []
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(running(*argv, "server", env=environment, cwd=folder, stdin=subprocess.PIPE))
        assert server.stdout.readline() == "ready\n"
        await_libraries(here, server.pid)
        stream = observed(here, server.pid)
        assert isinstance(next(stream), Began)
        clients = [
            stack.enter_context(
                running(*argv, name, number, COUNT, ahead, env=environment, cwd=folder, stdin=subprocess.PIPE)
            )
            for name, number in (("one", 1), ("two", 2))
        ]
        pids = {process.pid for process in (server, *clients)}
        while not pids <= {server.pid, *(program.program.pid for batch in batches for program in batch.programs)}:
            batches.append(next(stream))
        for client in clients:
            client.stdin.write("\n")
            client.stdin.flush()
        while any(client.poll() is None for client in clients):
            batches.append(next(stream))
        batches += [next(stream), next(stream)]
        stream.close()
        printed = [process.communicate()[0] for process in (server, *clients)]
    assert not [gap for batch in batches for gap in batch.gaps]
    flows = FlowAccumulator(begin_ns=batches[0].begin_ns)
    roster = Roster(())
    for batch in batches:
        for program in batch.programs:
            if program.program.pid in pids:
                roster.begin(program.program)
        flows.observe(roster.alive)
        flows.feed([hit for hit in batch.hits if hit.pid in pids])
    flows.finish()
    return [stream for stream in streams(flows) if stream.kind is SERVICE], "".join(printed)


def times_printed(text, word):
    """The lines of one sort: two times for each client and number."""
    lines = (line.split() for line in text.splitlines())
    return {(client, int(number)): (int(a), int(b)) for first, client, number, a, b in lines if first == word}


@pytest.mark.parametrize("distro", RELEASES)
def test_each_request_is_seen_from_its_client_and_back(here, distro, tmp_path):
    """Of clients that send at the same times; from Kilted on, before they have the answer to the request before."""
    has_numbers = distro != "jazzy"
    found, printed = watched(here, tmp_path, ros2_environment(distro, tmp_path), 3 if has_numbers else 0)
    calls, work = times_printed(printed, "call"), times_printed(printed, "work")
    assert set(calls) <= set(work) and len(calls) > COUNT
    clients = {stream.identity["client"]: stream for stream in found}
    # The second client of a process has its label with a number.
    (second,) = (label for label in clients if label.endswith(" (2)"))
    first = second.removesuffix(" (2)")
    (other,) = set(clients) - {first, second}
    assert len(found) == len(clients) == 3
    for label, name in ((other, "one0"), (first, "two0"), (second, "two1")):
        stream = clients[label]
        assert (stream.identity["service"], stream.identity["server"]) == ("/types", NODE.name)
        rows = np.stack([stream.columns[column] for column in SERVICE.columns])
        sent, received, taken, answered = rows[:, np.argsort(rows[0])]
        numbers = sorted(number for client, number in calls if client == name)
        sent_told, received_told = np.array([calls[name, number] for number in numbers]).T
        begun, ended = np.array([work[name, number] for number in numbers]).T
        # The request of each call is the first one that is seen after its program told when it sends.
        row = np.searchsorted(sent, sent_told)
        if has_numbers:
            assert row.tolist() == list(range(sent.size)) and stream.counts["unclear"] == 0
        else:
            # What got lost on the way back may seem to be taken at a look that found nothing.
            assert sent.size + stream.counts["unclear"] <= COUNT
            assert np.unique(row).size >= len(numbers) - stream.counts["unclear"]
            is_seen = np.append(np.diff(row) > 0, row[-1] < sent.size)
            assert np.count_nonzero(is_seen) > 0.8 * len(numbers)
            row, sent_told, received_told, begun, ended = (
                column[is_seen] for column in (row, sent_told, received_told, begun, ended)
            )
        sent, received, taken, answered = (column[row] for column in (sent, received, taken, answered))
        # Each lies between two times that the programs told.
        assert np.all((sent_told < sent) & (sent < taken) & (taken < begun))
        assert np.all((ended < answered) & (answered < received) & (received < received_told))
