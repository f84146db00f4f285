"""What a report says before it has a form: its answer in a sentence, pooled figures, and where formulas stand."""

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from report.campaigns import latencies, oneshot_run

from rtrun.analysis.figures import figures_of_samples
from rtrun.judgement.digest import pool_figures
from rtrun.judgement.study import study
from rtrun.plan.question import Question
from rtrun.report.contents import Contents, contents
from rtrun.report.end_tables import WORST_CASE
from rtrun.results.importers.adopt import adopt
from rtrun.targets.inspection.platform import Platform

TOP = Path(__file__).parents[3]
LATENCIES_NS = (latencies(5000, 1), latencies(3000, 2, mean_us=120.0))


def write(root: Path, **record) -> Path:
    for name, values in zip("ab", LATENCIES_NS, strict=True):
        oneshot_run(root, name, values, logs=True, **record)
    return root


def contents_of(root: Path, **question: float) -> Contents:
    return contents(study(root, Question(**question)))


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
            "The deadline of 400 us is met in the one scenario: P(latency > 400 us) is below 0.01",
            "keep it so",
        ),
        ({}, "It is not decided whether the deadline of 400 us is met: NEEDS MORE 1 of 1.", "measure more"),
        ({"deadline_ns": 90_000}, "The deadline of 90 us is not met: REFUTED 1 of 1.", "rtrun check-rt --target"),
    ],
)
def test_the_answer_is_a_sentence_and_the_next_step_follows_from_it(tmp_path, question, answer, step):
    written = contents_of(write(tmp_path), **question)
    assert written.answer.startswith(answer)
    assert written.next_step.startswith(step)
    assert written.worst is not None and written.worst.figures.max_ns == max(v.max() for v in LATENCIES_NS)


def test_the_claims_are_named_where_runs_bear_on_them(tmp_path):
    folder = write(tmp_path / "our results")
    claims = f"Claims of the thesis: rtrun claims '{folder}'"
    assert contents_of(folder).remarks[-1] == claims
    histogram = tmp_path / "cyclictest.txt"
    histogram.write_text("# Histogram\n000010 002000\n# Total: 000002000\n# Max Latencies: 00010\n")
    adopt(histogram, tmp_path / "cyclictest", platform=Platform.HARDWARE)
    assert [text for text in contents_of(tmp_path / "cyclictest").remarks if "laims" in text] == []


def test_worst_cases_take_one_line_unless_there_is_one(tmp_path):
    """These few values allow no bound. Where there is one, its table has what was refused, too."""
    analysed = study(write(tmp_path))
    written = contents(analysed)
    (line,) = (text for text in written.remarks if text.startswith(WORST_CASE))
    assert "no bound in any of 1 scenario" in line and "worst-case" not in {table.id for table in written.tables}
    (group,) = analysed.groups
    given = dataclasses.replace(
        group.bounds[0], level_ns=150_000.0, low_ns=140_000, high_ns=160_000, shape=0.1, refused=None
    )
    bounds = (given, *group.bounds[1:])
    written = contents(dataclasses.replace(analysed, groups=(dataclasses.replace(group, bounds=bounds),)))
    (table,) = (table for table in written.tables if table.id == "worst-case")
    assert table.outcome.startswith("a bound in 1 of 1 scenarios, the highest 160.0 us") and len(table.rows) == 3
    assert not any(text.startswith(WORST_CASE) for text in written.remarks)


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
    assert written.next_step.startswith("keep it so: rtrun gate RESULTS --platform virtual fails")


def test_figures_of_several_runs_are_those_of_all_their_values(tmp_path):
    (group,) = study(write(tmp_path)).groups
    pooled, whole = pool_figures(group.digests), figures_of_samples(np.concatenate(LATENCIES_NS))
    assert (pooled.n, pooled.min_ns, pooled.max_ns) == (whole.n, whole.min_ns, whole.max_ns)
    assert pooled.mean_ns == pytest.approx(whole.mean_ns) and pooled.std_ns == pytest.approx(whole.std_ns)
    for percentile, value_ns in whole.percentiles_ns.items():
        assert pooled.percentiles_ns[percentile] <= value_ns < pooled.percentiles_ns[percentile] + pooled.bin_ns


def test_the_sections_that_hold_the_formulas_are_there(tmp_path):
    named = {
        section
        for text in texts(contents_of(write(tmp_path)))
        for section in re.findall(r"docs/analysis\.md, (.+?)\.", text)
    }
    headings = set(re.findall(r"^## (.+)$", (TOP / "docs/analysis.md").read_text(), re.M))
    assert {"Deadline", "What counts as what", "Worst case"} <= named <= headings


def test_no_text_holds_a_command_to_a_terminal(tmp_path):
    evil = "\x1b]0;x\x07\nFORGED line"
    target = {"name": evil, "kernel_release": evil, "kernel_version": evil}
    for name, parameters in (("a", {"cpu": evil}), ("b", {"condition": evil})):
        oneshot_run(tmp_path, name, LATENCIES_NS[0], parameters=parameters, target=target, run=evil)
    oneshot_run(tmp_path, "c", LATENCIES_NS[0], status="failed", reason=evil)
    written = contents_of(tmp_path)
    assert any("FORGED" in text for text in texts(written))
    assert [text for text in texts(written) if not text.isprintable()] == []
    assert all(re.fullmatch("[a-z0-9-]+", one.id) and one.condition.isprintable() for one in written.scenarios)
