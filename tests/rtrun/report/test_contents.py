"""What a report says before it has a form: its answer in a sentence, pooled figures, and where formulas stand."""

import dataclasses
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report.campaigns import latencies, message_run, oneshot_run
from traced import specimen, write_traced_run

from rtrun.analysis.figures import figures_of_samples
from rtrun.judgement.digest import pool_figures
from rtrun.judgement.study import study
from rtrun.plan.question import THESIS
from rtrun.report.contents import Contents, contents
from rtrun.report.how import DATA, explanations
from rtrun.report.page import html

REPORT = DATA.parent
LATENCIES_NS = (latencies(5000, 1), latencies(3000, 2, mean_us=120.0))


def write(root: Path, **record) -> Path:
    for name, values in zip("ab", LATENCIES_NS, strict=True):
        oneshot_run(root, name, values, logs=True, **record)
    return root


def contents_of(root: Path, **question: float) -> Contents:
    return contents(study(root, replace(THESIS, **question)))


def texts(value: object) -> Iterator[str]:
    """Every text in the contents but those of the study that they were made of."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from texts(list(value.items()))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from texts(item)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name != "group":
                yield from texts(getattr(value, field.name))


@pytest.mark.parametrize(
    ("question", "answer", "step"),
    [
        (
            {"probability": 1e-2},
            "The deadline of 400 us is met in the one scenario: at most 1 in 100 late, 95 % sure, on boots that",
            "measure on 5 boots or more, as boots differ; then keep it so: rtrun gate RESULTS fails",
        ),
        (
            {},
            "It is not decided whether the deadline of 400 us is met. Asked: at most 1 in a million late, 95 % sure.",
            "measure more",
        ),
        (
            {"deadline_ns": 90_000},
            "The deadline of 90 us is not met. Asked: at most 1 in a million late, 95 % sure.",
            "rtrun check-rt --target",
        ),
    ],
)
def test_the_answer_is_a_sentence_and_the_next_step_follows_from_it(tmp_path, question, answer, step):
    written = contents_of(write(tmp_path), **question)
    assert written.answer.startswith(answer)
    assert written.next_step.startswith(step)
    assert written.worst is not None and written.worst.figures.max_ns == max(v.max() for v in LATENCIES_NS)


def test_an_answer_that_a_change_prevents_begins_with_the_change(tmp_path):
    values = np.minimum(latencies(20_000, 1), 399_000)
    values[15_000::50] = 900_000
    oneshot_run(tmp_path, "a", values)
    undecided = "it is not decided whether the deadline of 400 us is met"
    written = contents_of(tmp_path, probability=1e-2)
    assert written.answer.startswith(f"The system changed while it was measured, so {undecided}. Asked: ")
    assert written.next_step.startswith("the plots of the report show when")
    # Where something else is missing, too, only the line of the scenario says what changed.
    oneshot_run(tmp_path, "b", latencies(100, 1), policy="FIFO")
    assert contents_of(tmp_path, probability=1e-2).answer.startswith(f"I{undecided[1:]} in 2 of 2 scenarios.")


def test_claims_and_worst_cases_stand_in_a_report_where_they_are_answered(tmp_path):
    """These few values allow no bound. Where there is one, its table has what was refused, too."""
    analysed = study(write(tmp_path), THESIS)
    written = contents(analysed)
    assert "worst-case" not in {table.id for table in written.tables}
    assert not [text for text in texts(written) if re.search("[Cc]laims|extreme value", text)]
    (group,) = analysed.groups
    given = dataclasses.replace(
        group.bounds[0], level_ns=150_000.0, low_ns=140_000, high_ns=160_000, shape=0.1, refused=None
    )
    bounds = (given, *group.bounds[1:])
    written = contents(dataclasses.replace(analysed, groups=(dataclasses.replace(group, bounds=bounds),)))
    (table,) = (table for table in written.tables if table.id == "worst-case")
    assert table.outcome.startswith("a bound in 1 of 1 scenarios, the highest 160 us") and len(table.rows) == 3


def test_next_is_the_cause_and_its_remedy_where_there_are_traces(tmp_path):
    write_traced_run(tmp_path, {1558: specimen(1558)}, [23166, 23175])
    step = contents_of(tmp_path).next_step
    assert step.startswith(
        "thread of higher priority planted_hog (pid 23165, real-time 98 above real-time 95): the main cause of 1 of 1"
    )
    assert ". planted_hog: give the thread a lower real-time priority" in step


def test_an_emulated_board_says_nothing_about_a_deadline(tmp_path):
    oneshot_run(tmp_path, "a", LATENCIES_NS[0], platform="emulated")
    written = contents_of(tmp_path)
    assert written.banner is not None and written.banner.startswith("EMULATED")
    assert written.answer == "No statement about the deadline of 400 us in any scenario: measured on an emulated board."


def test_a_proof_from_a_virtual_machine_says_what_it_is_for(tmp_path):
    oneshot_run(tmp_path, "a", LATENCIES_NS[0], platform="virtual")
    written = contents_of(tmp_path, probability=1e-2)
    assert written.banner == "VIRTUAL: verdicts are for this virtual machine on this host"
    assert ("platform", "virtual: stated by the test") in written.facts
    assert "then keep it so: rtrun gate RESULTS --platform virtual fails" in written.next_step


def test_figures_of_several_runs_are_those_of_all_their_values(tmp_path):
    (group,) = study(write(tmp_path), THESIS).groups
    pooled, whole = pool_figures(group.digests), figures_of_samples(np.concatenate(LATENCIES_NS))
    assert (pooled.n, pooled.min_ns, pooled.max_ns) == (whole.n, whole.min_ns, whole.max_ns)
    assert pooled.mean_ns == pytest.approx(whole.mean_ns) and pooled.std_ns == pytest.approx(whole.std_ns)
    for percentile, value_ns in whole.percentiles_ns.items():
        assert pooled.percentiles_ns[percentile] <= value_ns < pooled.percentiles_ns[percentile] + pooled.bin_ns


def test_how_figures_are_made_is_in_the_report(tmp_path):
    """Who reads it need not have the documentation."""
    write(tmp_path)
    named = set(re.findall(r'how="([a-z-]+)"', "".join(path.read_text() for path in REPORT.glob("*.py"))))
    assert named | {"answers"} == set(explanations())
    assert not [text for text in texts(contents_of(tmp_path)) if "docs/" in text]


def test_no_text_holds_a_command_to_a_terminal(tmp_path):
    evil = "\x1b]0;x\x07\nFORGED line"
    target = {"name": evil, "kernel_release": evil, "kernel_version": evil}
    for name, parameters in (("a", {"cpu": evil}), ("b", {"condition": evil})):
        oneshot_run(tmp_path, name, LATENCIES_NS[0], parameters=parameters, target=target, run=evil)
    oneshot_run(tmp_path, "c", LATENCIES_NS[0], status="failed", reason=evil)
    written = contents_of(tmp_path)
    assert any("FORGED" in text for text in texts(written))
    assert [text for text in texts(written) if not text.isprintable()] == []
    assert all(
        re.fullmatch("[a-z0-9-]+", scenario.id) and scenario.condition.isprintable() for scenario in written.scenarios
    )


def test_repeated_runs_are_reproduced_by_one_line_that_a_shell_takes(tmp_path: Path) -> None:
    programs = [{"name": "oneshot_timer_tests", "argv": ["oneshot_timer_tests", "-p", "a b"], "exit_status": 0}]
    for name, policy in (("a", "RR"), ("b", "RR"), ("c", "FIFO")):
        oneshot_run(tmp_path, name, LATENCIES_NS[0], policy=policy, programs=programs)
    oneshot_run(tmp_path, "d", LATENCIES_NS[0], variant="new", programs=programs)
    (table,) = [table for table in contents_of(tmp_path).tables if table.id == "reproduce"]
    measured = [how for what, how in table.rows if what == "measured"]
    line = "oneshot_timer_tests -p 'a b'"
    assert measured == [f"a and 1 like it: {line}", f"c: {line}", f"d: {line}"]


@pytest.mark.parametrize(("lost", "text"), [(800, "80 % missing"), (5, "")])
def test_a_worst_value_stands_beside_the_share_that_never_came(tmp_path, lost, text):
    message_run(tmp_path, "a", [latencies(1000, 3)], lost=tuple(range(100, 100 + lost)))
    analysed = study(tmp_path, replace(THESIS, probability=1e-2))
    written = contents(analysed)
    page = html(analysed, written)
    (scenario,) = written.scenarios
    assert scenario.missing == text and (written.missing is scenario) is bool(text)
    overview = re.findall(r'<a class="row.*?</a>', page, re.S)
    assert [f'<span class="worst">{text}</span>' in row for row in overview] == [bool(text)]
    assert (f'Most values missing: <a href="#{scenario.id}"><b>{text}</b>' in page) is bool(text)
