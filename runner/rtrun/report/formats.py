"""The other formats of a report: Markdown, JSON, JUnit, LAVA, CSV, Parquet. The same study gives the same bytes."""

import csv
import io
import json
import re
from typing import Any
from xml.etree import ElementTree

from rtfiles.errors import UsageError
from rtfiles.invocation import install_extra
from rtfiles.output import printable
from rtrun.judgement.digest import Digest
from rtrun.judgement.gate import Gate
from rtrun.judgement.study import Study
from rtrun.report.contents import Contents
from rtrun.report.how import explanations
from rtrun.report.quantities import as_data, identity, lost, times_ns, us
from rtrun.report.run_facts import fingerprint
from rtrun.report.tables import Table

_PARAMETERS = ("policy", "timeout_us", "frequency_hz", "payload_bytes", "subscribers")
# Characters that XML 1.0 cannot contain.
_NOT_XML = dict.fromkeys([*(c for c in range(32) if chr(c) not in "\t\n\r"), *range(0xD800, 0xE000), 0xFFFE, 0xFFFF])


def markdown(contents: Contents) -> str:
    """The report as Markdown; the banner is its first line."""
    parts = [f"**{contents.banner}**", ""] if contents.banner else []
    parts += [f"# {_plain(contents.title)}", "", f"**{_plain(contents.answer)}**", "", contents.question, ""]
    parts += [f"- {what}: {_plain(value)}" for what, value in contents.facts]
    parts += ["", f"Next: {_plain(contents.next_step)}.", ""]
    parts += [
        f"- **{scenario.answer}** {_plain(scenario.label)}: {_plain(scenario.text)}" for scenario in contents.scenarios
    ]
    if contents.left_out:
        parts += ["", "Not analysed:", "", *(f"- {_plain(text)}" for text in contents.left_out)]
    for scenario in contents.scenarios:
        parts += ["", f"## {_plain(scenario.label)}"]
        for table in scenario.tables:
            parts += ["", f"### {table.title}", "", *_markdown_table(table)]
    for table in contents.tables:
        parts += ["", f"## {table.title}", "", f"{_plain(table.outcome)}.", "", *_markdown_table(table)]
    parts += ["", "## How figures are made"]
    for how in explanations().values():
        parts += ["", f"### {how.title}", "", *(f"{_plain(text)}\n" for text in how.paragraphs)]
    return "\n".join(parts) + "\n"


def _markdown_table(table: Table) -> list[str]:
    lines = ["| " + " | ".join(table.columns) + " |"]
    lines.append("|" + "|".join("---:" if k in table.numbers else "---" for k in range(len(table.columns))) + "|")
    for place, row in enumerate(table.rows):
        rows = (row, *table.parts.get(place, ()))
        lines += ["| " + " | ".join(_plain(cell) for cell in cells) + " |" for cells in rows]
    return lines + ([""] + [f"{_plain(note)}  " for note in table.notes] if table.notes else [])


def _plain(text: str) -> str:
    """Text that stays plain text in a Markdown cell."""
    for special in "\\`*_<>|[]":
        text = text.replace(special, "\\" + special)
    return " ".join(text.split())


def as_json(study: Study) -> str:
    """All findings, for programs; numbers that do not exist are null."""
    data = {
        "schema": 2,
        "platform": study.platform,
        "of": study.asked.of,
        "tolerate": str(study.question.tolerance),
        "deadline_ns": study.question.deadline_ns,
        "probability": study.question.probability,
        "confidence": study.question.confidence,
        "input_sha256": fingerprint(study),
        "groups": [
            {
                **{name: getattr(group, name) for name in ("label", "suite", "series", "target", "parameters")},
                "runs": list(group.runs),
                "n": group.n,
                "verdict": as_data(group.verdict),
                "undecidable": group.undecidable,
                "worst_case": as_data(group.bounds),
                "no_worst_case": group.no_bound,
            }
            for group in study.answers
        ],
        "series": [_series(digest) for digest in (*study.digests, *study.others)],
        "left_out": list(study.left_out),
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _series(digest: Digest) -> dict[str, Any]:
    return {
        "run": digest.run,
        **identity(digest.header),
        "platform": digest.header.platform,
        "figures": as_data(digest.figures),
        "startup": as_data(digest.header.startup),
        "negative_cluster": as_data(digest.cluster),
        **lost(digest.header),
        "remarks": list(digest.header.remarks),
    }


def junit(gate: Gate) -> str:
    """The gate as JUnit XML: one test case per group; anything not proven is a failure, whatever the reason."""
    counts = {
        "tests": str(len(gate.cases)),
        "failures": str(sum(not case.passed for case in gate.cases)),
        "errors": "0",
    }
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {"name": "rtrun gate", **counts, "skipped": "0"})
    for case in gate.cases:
        element = ElementTree.SubElement(suite, "testcase", {"classname": "deadline", "name": _xml(case.about)})
        if case.passed:
            ElementTree.SubElement(element, "system-out").text = _xml(case.in_full)
        else:
            message = _xml(f"{case.answer}: {case.in_full}")
            ElementTree.SubElement(element, "failure", {"type": case.answer, "message": message})
    ElementTree.indent(root, "")
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=False).join(
        ('<?xml version="1.0" encoding="UTF-8"?>\n', "\n")
    )


def _xml(text: str) -> str:
    return text.translate(_NOT_XML)


def lava(study: Study, gate: Gate) -> str:
    """In each line, the arguments for LAVA's `lava-test-case`: the gate's cases, and figures as measurements."""
    lines = [f"{_test_case(case.about)} --result {'pass' if case.passed else 'fail'}" for case in gate.cases]
    for digest in study.digests:
        lines += [
            f"{_test_case(f'{digest.run} {digest.header.output} {name}')} --result pass --measurement {value / 1000:g} "
            "--units us"
            for name, value in times_ns(digest.figures).items()
            if value is not None and name not in ("min", "mean", "std")
        ]
    return "".join(f"{line}\n" for line in lines)


def _test_case(text: str) -> str:
    """The name of a test case, without any character that means something to LAVA or to a shell."""
    return re.sub(r"[^A-Za-z0-9_.]+", "-", text).strip("-")


def rows(study: Study) -> list[dict[str, Any]]:
    """The table as plain rows, one per series of an output, for CSV and Parquet. Times in us."""
    return [
        {key: printable(value) if isinstance(value, str) else value for key, value in _plain_row(digest).items()}
        for digest in (*study.digests, *study.others)
    ]


def _plain_row(digest: Digest) -> dict[str, Any]:
    header, parameters = digest.header, digest.header.parameters
    return {
        "run": digest.run,
        **{name: getattr(header, name) for name in ("suite", "output", "series")},
        **{key: None if parameters.get(key) is None else str(parameters[key]) for key in _PARAMETERS},
        "platform": header.platform,
        "n": digest.n,
        **{f"{name}_us": us(value_ns) for name, value_ns in times_ns(digest.figures).items()},
        **lost(header),
    }


def as_csv(study: Study) -> str:
    """The table as CSV with a header line; an empty cell is a number that does not exist.

    A text that a spreadsheet would take for a formula gets a leading apostrophe.
    """
    table = [{key: _no_formula(value) for key, value in row.items()} for row in rows(study)]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(table[0]) if table else ["run"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return stream.getvalue()


def _no_formula(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value


def parquet(study: Study) -> bytes:
    """The table as Parquet. Raises UsageError when pyarrow is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError(f"--format parquet needs pyarrow: {install_extra('report')}") from error
    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows(study)), stream)
    return stream.getvalue()
