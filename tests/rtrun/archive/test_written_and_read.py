"""What one command writes into an archive all others read, in the order of writing, whatever clocks say."""

import json
import os
import re
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from itertools import count, pairwise
from unittest import mock

import fsspec
import pytest
from archive.archived import write_build, write_course
from archive.test_compacting import NOW, answers, compacted, files
from fsspec.implementations.memory import MemoryFileSystem
from hypothesis import HealthCheck, Phase, given, settings, strategies
from pydantic import ValidationError

from rtfiles.errors import UsageError
from rtrun import cli
from rtrun.archive import notes, notifications
from rtrun.archive.alarms import Alarm
from rtrun.archive.compacting import Compaction, compact
from rtrun.archive.notes import AcceptNote, IgnoreNote, KnownNote, RetainNote, WithdrawNote, add_note, read_notes
from rtrun.archive.notifications import ALARMS_MAX, add_told, read_told
from rtrun.archive.runs import read_archive
from rtrun.archive.stamps import next_stamp, read_stamp
from rtrun.archive.store import make_archive, open_archive
from rtrun.cli import main
from rtrun.commands.archive import _TOLD_BY as OPTIONS

WHO = ("--reason", "disk", "--who", "E. Noether")
TIMES = strategies.datetimes(datetime(1901, 1, 1), datetime(2998, 1, 1))
# Clocks of machines that write one after the other: they stand, go back, and differ by years.
CLOCKS = TIMES | strategies.sampled_from([datetime(2026, 11, 24, 10, 0, second) for second in (0, 1)])
TEXTS = strategies.text(strategies.characters(exclude_categories=["Cs"]), min_size=1, max_size=1000)
FIELDS = {
    **dict.fromkeys(("who", "reason"), TEXTS),
    **dict.fromkeys(notes.PATTERNS, strategies.none() | TEXTS),
    "at": CLOCKS,
    "begin": TIMES,
    "end": strategies.none() | TIMES,
    "table": strategies.sampled_from(["samples", "histograms", "runs"]),
    "days": strategies.none() | strategies.integers(1, 100_000),
    "note": TEXTS,
}
addresses = (f"memory://{number}/archive" for number in count())


def notes_of(kind):
    """Any note of a kind, with all of its fields."""
    return strategies.builds(kind, **{name: FIELDS[name] for name in kind.model_fields if name != "kind"})


NOTES = strategies.one_of(*map(notes_of, (IgnoreNote, AcceptNote, KnownNote, RetainNote, WithdrawNote)))


@settings(deadline=None)
@given(strategies.lists(strategies.tuples(NOTES, strategies.integers(0, 20)), max_size=8))
def test_notes_are_read_as_they_were_written(written):
    """In object storage; whatever clocks say, those that hold stand in the order in which they were written."""
    store = make_archive(next(addresses))
    held = {}
    for note, place in written:
        if isinstance(note, WithdrawNote) and held:
            note = note.model_copy(update={"note": [*held][place % len(held)]})
        name = add_note(store, note)
        assert name not in held
        if isinstance(note, WithdrawNote):
            held.pop(note.note, None)
        else:
            held[name] = note
        assert [*read_notes(store).held.items()] == [*held.items()]
    for name, note in held.items():
        assert notes.in_words(name, note)
    known = read_notes(store)
    for table in ("samples", "histograms", "runs"):
        kept = [note.days for note in held.values() if isinstance(note, RetainNote) and note.table in (table, "runs")]
        assert (known.kept_since(table, datetime(2999, 1, 1)) is None) <= (None in kept or not kept)


@settings(deadline=None)
@given(strategies.lists(strategies.tuples(CLOCKS, strategies.none() | strategies.integers(1, 99)), max_size=6))
def test_the_last_retain_counts_once_its_clock_is_reached(written):
    store = make_archive(next(addresses))
    for at, days in written:
        add_note(store, RetainNote(at=at, who="x", reason="x", table="samples", days=days))
    now = datetime(2999, 1, 1)  # after all clocks
    since = read_notes(store).kept_since("samples", now)
    last = written[-1][1] if written else None
    assert since == (None if last is None else now - timedelta(days=last))


@settings(deadline=None)
@given(
    strategies.lists(strategies.builds(Alarm, **{
        **dict.fromkeys(("about", "size", "since", "suspected"), TEXTS), "kind": strategies.just("worse"),
        "page": strategies.none(), "key": strategies.from_regex("[0-9a-f]{64}", fullmatch=True),
        "last_run": strategies.none() | TIMES,
        "levels": strategies.dictionaries(
            strategies.sampled_from(["p50", "p99", "p99.9", "P(miss)"]),
            strategies.tuples(*[strategies.floats(allow_nan=False, allow_infinity=False)] * 2),
        ),
    }), max_size=3),
    strategies.lists(CLOCKS, min_size=1, max_size=4),
)  # fmt: skip
def test_messages_are_read_as_they_were_told(alarms, clocks):
    store = make_archive(next(addresses))
    for number, clock in enumerate(clocks):
        add_told(store, f"receiver {number}", alarms, clock)
    messages = read_told(store)
    assert [message.receiver for message in messages] == [f"receiver {number}" for number in range(len(clocks))]
    assert all([alarm.key for alarm in message.alarms] == [alarm.key for alarm in alarms] for message in messages)


def test_the_largest_message_is_read_again():
    store = make_archive(next(addresses))
    levels = dict.fromkeys(("p50", "p99", "p99.9", "P(miss)"), (-sys.float_info.max / 3, 0.0))
    largest = [
        Alarm(kind="worse", about="x", size="x", since="x", suspected="x", page=None, key=f"{number:064x}",
              last_run=datetime(2026, 1, 1, 1, 1, 1, 1), levels=levels)
        for number in range(ALARMS_MAX)
    ]  # fmt: skip
    add_told(store, "x" * 100, largest, datetime(2026, 1, 1))
    assert len(read_told(store)[0].alarms) == ALARMS_MAX


# Every command that is given an archive. Those of the first list only read it.
READ = {
    "history": [["ARCHIVE"], ["ARCHIVE", "--by", "run", "--json"]],
    "trends": [["ARCHIVE"], ["ARCHIVE", "--json"]],
    "site": [["ARCHIVE", "--output", "SITE"]],
    "bisect": [["ARCHIVE", "--order", "ORDER"]],
    "gate": [["BUILD", "--against", "ARCHIVE"]],
    "notify": [["RECEIVERS", "ARCHIVE"], ["RECEIVERS", "ARCHIVE", "--results", "BUILD"]],
    "archive": [
        ["annotate", "ARCHIVE"],
        ["compact", "ARCHIVE"],
        ["compact", "ARCHIVE", "--grace", "1ns"],
        ["add", "BUILD", "--to", "ARCHIVE"],
    ],
    "farm": [],  # its coordinator is a real one in tests/rtrun/targets/labgrid
}


def test_every_command_that_takes_an_archive_is_in_the_list(capsys):
    taking = set()
    for name in cli.COMMANDS:
        assert main([name.rstrip("_").replace("_", "-"), "--help"]) == 0
        if re.search(r"\bARCHIVE\b|keep runs of many months", capsys.readouterr().out):
            taking.add(name)
    assert taking == {*READ}


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """An archive in which a scenario got worse, a build, and a receiver."""
    top = tmp_path_factory.mktemp("lab")
    with mock.patch("os.fsync"):
        write_course(top / "ARCHIVE", [100.0] * 8 + [120.0] * 8, facts=[{"commit": f"c{day}"} for day in range(16)])
    write_build(top / "BUILD", 120.0, 120.0)
    (top / "ORDER").write_text("".join(f"c{day}\n" for day in range(16)))
    (top / "RECEIVERS").write_text("schema: 1\nreceivers: [{name: log, kind: command, command: ['true']}]\n")
    return top


PATTERNS = TEXTS.filter(lambda text: not text.startswith("-")) | strategies.sampled_from(["*", "board", "[", "b*"])
WORDS = strategies.one_of(
    strategies.tuples(
        strategies.just("retain"),
        FIELDS["table"],
        strategies.sampled_from(["forever", "12w", "10950d"]) | strategies.integers(1, 3650).map("{}d".format),
    ),
    *[
        strategies.lists(strategies.tuples(strategies.sampled_from(options), PATTERNS), max_size=3).map(
            lambda pairs, kind=kind: ("annotate", kind, *(word for pair in pairs for word in pair))
        )
        for kind, options in (
            ("--ignore", [option for option, _ in OPTIONS.values()]),
            ("--known", ["--machine", "--scenario"]),
            ("--accept=", ["--machine", "--scenario"]),
        )
    ],
)


# An example takes seconds, and a shorter one says no more.
@settings(
    max_examples=10,
    deadline=None,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(strategies.lists(WORDS, min_size=1, max_size=4), TIMES, TEXTS.filter(lambda text: "\0" not in text))
def test_what_a_command_writes_all_commands_read(lab, tmp_path, capsys, written, begin, reason):
    """A command may refuse to write; what it wrote is no reason for any command to fail."""
    archive = tmp_path / f"archive {next(addresses).split('/')[2]}"
    subprocess.run(["cp", "-rl", lab / "ARCHIVE", archive], check=True)
    for action, *words in written:
        more = ["--from", begin.isoformat()] if "--accept=" in words else []
        words = [word.removesuffix("=") for word in words]
        if action == "annotate":
            words = [f"{option}={value}" for option, value in zip(words[1::2], words[2::2], strict=True)] + words[:1]
        before = len(list(archive.glob("notes/*")))
        status = main(["archive", action, str(archive), *words, *more, f"--reason={reason}", "--who", "E. Noether"])
        assert status in (0, 2) and len(list(archive.glob("notes/*"))) == before + (status == 0)
    capsys.readouterr()
    places = {name: str(lab / name) for name in ("BUILD", "ORDER", "RECEIVERS")}
    places |= {"ARCHIVE": str(archive), "SITE": str(tmp_path / "site")}
    for name, calls in READ.items():
        for words in calls:
            status = main([name, *(places.get(word, word) for word in words)])
            err = capsys.readouterr().err
            # Notes may ignore every run, or retain none; that is an answer, no damage.
            assert status in (0, 1) or re.search("no run|NO HISTORY|16 lines, but no ", err), (name, words, err)
            assert "notes/" not in err and "told/" not in err


def test_retain_forever_as_documented_is_read(lab, tmp_path, capsys):
    """Those that an earlier version wrote, without the key, too."""
    subprocess.run(["cp", "-r", lab / "ARCHIVE", tmp_path / "a"], check=True)
    assert main(["archive", "retain", str(tmp_path / "a"), "samples", "forever", *WHO]) == 0
    (path,) = (tmp_path / "a/notes").iterdir()
    written = json.loads(path.read_text())
    path.with_name("20200101T000000Z-0a1b2c3d.json").write_text(
        json.dumps({name: value for name, value in written.items() if name != "days"})
    )
    assert main(["archive", "annotate", str(tmp_path / "a")]) == 0
    assert capsys.readouterr().out.count("samples are kept for ever: disk (E. Noether, ") == 3


@pytest.mark.parametrize("turn", range(6))
def test_two_retains_within_one_second_delete_nothing(tmp_path, turn):
    """The second says forever; by the digests in their names either may stand first."""
    archive = write_course(tmp_path / "archive", [100.0] * 4)
    store = open_archive(str(archive))
    compact(store, grace=timedelta(0), now=NOW)
    at = datetime(2026, 11, 24)
    for days in (30, None):
        add_note(store, RetainNote(at=at, who="x", reason=f"turn {turn}", table="runs", days=days))
    compact(store, grace=timedelta(0), now=NOW + timedelta(days=1))
    assert len(read_archive(store).runs) == 8


def test_of_notes_that_nobody_can_order_the_longer_time_holds():
    """As earlier versions wrote them within a second, or two machines at the same moment."""
    at = datetime(2026, 11, 24)
    for days in ((30, None), (None, 30), (30, 90)):
        held = {
            f"20261124T000000Z-{number}{number}": RetainNote(at=at, who="x", reason="x", table="runs", days=limit)
            for number, limit in enumerate(days)
        }
        since = notes.Notes(held=held).kept_since("runs", datetime(2027, 1, 1))
        assert since == (None if None in days else datetime(2027, 1, 1) - timedelta(days=90))


def test_a_time_that_was_shortened_by_mistake_is_mended_within_the_grace(tmp_path):
    """Of all that held since the grace began the longest time counts, on a machine with a slow clock as well."""
    archive = write_course(tmp_path / "archive", [100.0] * 4)
    store, day = open_archive(str(archive)), timedelta(days=1)
    for at, days in ((NOW - 9 * day, None), (NOW - day / 2, 30)):
        add_note(store, RetainNote(at=at.replace(tzinfo=None), who="x", reason="x", table="runs", days=days))
    assert compact(store, grace=day, now=NOW).removed == 0 and len(files(archive)) == 9
    add_note(store, RetainNote(at=(NOW - 2 * day).replace(tzinfo=None), who="x", reason="x", table="runs", days=None))
    assert compact(store, grace=day, now=NOW + 30 * day).removed == 16 and len(read_archive(store).runs) == 8


def test_said_withdrawn_and_said_again_within_one_second(tmp_path):
    store = make_archive(str(tmp_path / "archive"))
    at = datetime(2026, 11, 24)
    note = KnownNote(at=at, who="x", reason="x", machine="board")
    first = add_note(store, note)
    add_note(store, WithdrawNote(at=at, who="x", reason="x", note=first))
    assert read_notes(store).held == {}
    second = add_note(store, note)
    assert [*read_notes(store).held] == [second]


def test_of_two_accepted_levels_of_one_time_the_later_note_counts(tmp_path):
    store = make_archive(str(tmp_path / "archive"))
    at = datetime(2026, 11, 24)
    for reason in ("first", "second"):
        add_note(store, AcceptNote(at=at, who="x", reason=reason, machine="board", begin=at))
    accepted = read_notes(store).accepted("board", "any")
    assert accepted and accepted.reason == "second"


@pytest.mark.parametrize("address", ["folder", "memory"])
def test_packs_of_machines_with_unequal_clocks(capsys, tmp_path, address):
    """The clock goes back by a year between two calls: a pack that is made later is newer, and the next call has
    nothing to do."""
    course = write_course(tmp_path / "course", [100.0] * 6)
    archive = str(tmp_path / "archive") if address == "folder" else next(addresses)
    store = make_archive(archive)

    def bring(days):
        for path in (path for day in days for path in course.glob(f"*/01{day:060d}??.parquet")):
            target = store.locate(f"{path.parent.name}/{path.name}")
            store.file_system.makedirs(target.rpartition("/")[0], exist_ok=True)
            store.file_system.pipe_file(target, path.read_bytes())

    year, day = timedelta(days=365), timedelta(days=1)
    bring(range(3))
    assert compact(store, grace=day, now=NOW + year).packs == 2
    bring(range(3, 6))
    before = answers(capsys, archive)
    assert compact(store, grace=day, now=NOW).packs == 2
    again = compact(store, grace=day, now=NOW)
    assert (again.packed, again.packs, again.removed) == (0, 0, 0)
    assert answers(capsys, archive) == before
    # The files wait for their grace by the clock of the pack that superseded them, and not for a year.
    assert compact(store, grace=day, now=NOW + day) == Compaction(removed=2 + 24)
    assert compact(store, grace=day, now=NOW + 2 * day) == Compaction()
    assert answers(capsys, archive) == before


def test_a_pack_of_an_earlier_version_is_of_the_time_in_its_name(capsys, tmp_path):
    archive = write_course(tmp_path / "archive", [100.0] * 3)
    compacted(archive)
    for path in archive.glob("*/pack-*"):
        stamp, _, digest = path.stem.removeprefix("pack-").split("-")
        path.rename(path.with_name(f"pack-{stamp}-{digest}.parquet"))
    before = answers(capsys, archive)
    assert compacted(archive, NOW + timedelta(days=1)) == Compaction(removed=12)
    assert answers(capsys, archive) == before


@given(strategies.lists(strategies.datetimes(datetime(1000, 1, 1)), max_size=5), strategies.text())
def test_stamps_ascend_whatever_the_clock_says(clocks, other):
    stamps = [other]
    for clock in clocks:
        stamps.append(next_stamp(stamps, clock.replace(microsecond=0)))
    assert all(first < second for first, second in pairwise(stamps[1:]))
    assert all(read_stamp(stamp) is not None for stamp in stamps[1:])
    if clocks:
        assert read_stamp(stamps[1]) == clocks[0].replace(microsecond=0, tzinfo=UTC)


def test_no_stamp_is_after_the_last_one():
    with pytest.raises(UsageError, match="99991231T235959Z: no name can be later"):
        next_stamp(["99991231T235959Z"], datetime(2026, 1, 1))
    assert read_stamp("20261324T000000Z") is None


def test_more_notes_than_are_read_are_not_written(lab, tmp_path, capsys, monkeypatch):
    subprocess.run(["cp", "-rl", lab / "ARCHIVE", tmp_path / "a"], check=True)
    for module, kind in ((notes, notes._KIND), (notifications, notifications._KIND)):
        monkeypatch.setattr(module, "_KIND", type(kind)(
            folder=kind.folder, reader=kind.reader, entries_max=2, bytes_max=kind.bytes_max))  # fmt: skip
    retain = ["archive", "retain", str(tmp_path / "a"), "samples", "90d", *WHO]
    assert [main(retain) for _ in range(3)] == [0, 0, 2]
    assert "notes: 2 files are there, and at most 2 are read: remove the oldest" in capsys.readouterr().err
    assert main(["history", str(tmp_path / "a")]) == 0
    # Nobody is told what the archive cannot remember.
    for number in range(3):
        receiver = {"name": f"log {number}", "kind": "command", "command": ["sh", "-c", f"echo >>{tmp_path}/heard"]}
        (tmp_path / "lab.yml").write_text(json.dumps({"schema": 1, "receivers": [receiver]}))
        assert main(["notify", str(tmp_path / "lab.yml"), str(tmp_path / "a")]) == (2 if number == 2 else 0)
    assert (tmp_path / "heard").read_text() == "\n\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--known", "--machine="), "an empty pattern fits nothing"),
        (("--known", "--machine", "x" * 1001), "machine"),
        (("--known", "--machine", os.fsdecode(b"\xff")), "unable to parse raw data as a unicode string"),
        (("--accept", "--from", "0001-01-01T00:00+02:00"), "begin: "),
        (("--accept", "--from", "9999-12-31T23:00-02:00"), "begin: "),
        (("--known", "--machine", "b", "--who", "x" * 1001), "who: "),
    ],
)
def test_what_could_not_be_read_is_refused_before_it_is_written(lab, tmp_path, capsys, words, message):
    subprocess.run(["cp", "-rl", lab / "ARCHIVE", tmp_path / "a"], check=True)
    assert main(["archive", "annotate", str(tmp_path / "a"), "--reason", "x", *words]) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "a/notes").exists()


def test_who_has_no_name_is_asked_for_one(lab, tmp_path, capsys):
    with mock.patch("getpass.getuser", side_effect=KeyError("getpwuid(): uid not found: 4711")):
        assert main(["archive", "retain", str(lab / "ARCHIVE"), "samples", "90d", "--reason", "x"]) == 2
    assert "--who: name yourself" in capsys.readouterr().err


def test_times_of_notes_with_a_zone_are_compared_in_utc():
    note = KnownNote.model_validate_json('{"at": "2026-11-24T10:00:00+02:00", "who": "x", "reason": "x"}')
    assert note.at == datetime(2026, 11, 24, 8)
    with pytest.raises(ValidationError, match="expected a time between 1900 and 3000"):
        KnownNote.model_validate_json('{"at": "9999-12-31T23:59:59-02:00", "who": "x", "reason": "x"}')


class CachingStore(MemoryFileSystem):
    """An object store whose client remembers what a folder had when it was listed first, as that of S3 does."""

    protocol = "caching"
    store: dict = {}  # noqa: RUF012
    pseudo_dirs = [""]  # noqa: RUF012
    cachable = False  # each machine has a client of its own

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self._listed = {}

    @classmethod
    def _strip_protocol(cls, path):
        return super()._strip_protocol(path.removeprefix("caching://"))

    def find(self, path, *, detail=False):
        if path not in self._listed:
            self._listed[path] = super().find(path, detail=True)
        return self._listed[path] if detail else sorted(self._listed[path])

    def invalidate_cache(self, path=None):
        self._listed.clear()


def test_what_another_machine_wrote_meanwhile_is_in_sight():
    fsspec.register_implementation("caching", CachingStore, clobber=True)
    fast, slow = (make_archive("caching://bucket/archive") for _ in range(2))
    read_notes(slow)
    days = datetime(2026, 11, 25), datetime(2026, 11, 24)
    for store, at, reason in zip((fast, slow), days, ("first", "second"), strict=True):
        add_note(store, KnownNote(at=at, who="x", reason=reason))
    assert [note.reason for note in read_notes(open_archive("caching://bucket/archive")).held.values()] == [
        "first",
        "second",
    ]
