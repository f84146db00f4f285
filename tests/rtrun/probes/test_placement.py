"""Where the probes go when a library cannot be read: the others are placed all the same."""

import dataclasses
import os
import shutil

import pytest
from probes.standin import EVENTS, find, running

from rtrun.probes import placement
from rtrun.targets.address import ThisMachine
from rtrun.targets.link import Link
from watched import PROBE


@pytest.fixture
def link(loopback):
    with Link(dataclasses.replace(loopback, address=ThisMachine()), print) as link:
        yield link


@pytest.fixture
def two(standin, tmp_path):
    """The same program twice; the libraries of the second are of a content of their own, which no cache holds."""
    folder = tmp_path / "his"
    shutil.copytree(standin.parent, folder)
    for library in folder.glob("*.so*"):
        with library.open("ab") as file:
            file.write(os.urandom(16))
    started = (500, 10**9, 4 * 10**15, 1000, "/placed")
    with running(standin, *started) as honest, running(folder / standin.name, *started) as elusive:
        yield honest, elusive, folder


def end(process, _folder):
    process.kill()
    process.wait()


def change(_process, folder):
    for library in folder.glob("*.so*"):
        library.write_bytes(b"another one")


def remove(_process, folder):
    shutil.rmtree(folder)


@pytest.mark.root
@pytest.mark.parametrize("act", [change, end, remove])
def test_a_library_that_is_gone_when_it_is_fetched(link, two, monkeypatch, act):
    """Its program ended, or its owner wished it: no probe is placed there, and that is reported."""
    honest, elusive, folder = two
    found = find(link, honest.pid, elusive.pid)
    look = placement._look

    def look_and_act(*arguments):
        release, files = look(*arguments)
        of_his = {mapped.inode for program in found if program.program.pid == elusive.pid for mapped in program.mapped}
        # As of a program in a container, whose files are seen through the process alone.
        ranges = {
            mapped.inode: mapped.range for program in found for mapped in program.mapped if mapped.inode in of_his
        }
        if act is end:
            files = {
                key: dataclasses.replace(file, path=f"/proc/{elusive.pid}/map_files/{ranges[key[1]]}")
                if key[1] in of_his
                else file
                for key, file in files.items()
            }
        act(elusive, folder)
        return release, files

    monkeypatch.setattr(placement, "_look", look_and_act)
    placed = placement.place(link, found, events=EVENTS)
    assert placed.probes and {probe.path.startswith(str(folder)) for probe in placed.probes} == {False}
    assert {refusal.reason for refusal in placed.refused if refusal.path.startswith(str(folder))} == {
        "its file cannot be read any more: its program has ended meanwhile, or the file was changed"
    }


@pytest.mark.root
def test_a_program_that_ended_before_its_library_is_looked_at(link, two):
    honest, elusive, folder = two
    found = find(link, honest.pid, elusive.pid)
    end(elusive, folder)
    placed = placement.place(link, found, events=EVENTS)
    assert placed.probes and {probe.path.startswith(str(folder)) for probe in placed.probes} == {False}
    assert {refusal.reason for refusal in placed.refused if refusal.path.startswith(str(folder))} == {
        "its file cannot be read, as its program has ended meanwhile, or this user is not root"
    }


def test_what_costs_more_is_named():
    probes = [dataclasses.replace(PROBE, event=event, is_stepped=event != "take") for event in ("end", "take", "begin")]
    assert placement.costly([*probes, dataclasses.replace(probes[0], path="/b")]) == (
        f"each end or begin in {PROBE.path} takes some 10 us longer: the kernel single-steps there",
        "each end in /b takes some 10 us longer: the kernel single-steps there",
    )
