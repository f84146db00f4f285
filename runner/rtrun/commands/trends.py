"""rtrun trends: when a quantile or P(miss) changed, by how much, and what else changed then."""

import argparse

from rtrun.commands._archive import add_archive, add_deadline, read_courses
from rtrun.commands._arguments import add_json
from rtrun.commands._question import add_confidence

HELP = "say when quantiles and P(miss) in an archive changed, by how much, and what else changed then"
EXAMPLES = (
    "rtrun trends archive",
    "rtrun trends archive --deadline 300us --json",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    add_deadline(parser)
    add_json(parser)
    add_confidence(parser)


def run(args: argparse.Namespace) -> int:
    """Print a few lines for each change."""

    from rtfiles.output import counted, print_json, print_line

    known = read_courses(args)
    from rtrun.archive.trends import as_data, as_text, trends

    shown = trends(known, confidence=args.confidence)
    if args.json:
        data = {"schema": 1, "deadline_ns": args.deadline, "changes": [as_data(trend) for trend in shown]}
        print_json(data)
        return 0
    boots = len({run.boot for course in known for run in course.runs})
    missed = sum(course.off_rate for course in known)
    left_out = f", without {counted(missed, 'run')} that missed the rate that was asked for" if missed else ""
    rests_on = f"{counted(len(known), 'course')}, of {counted(boots, 'boot')}{left_out}"
    print_line(f"{counted(len(shown), 'change')} in {rests_on}")
    for trend in shown:
        amount, *rest = as_text(trend, confidence=args.confidence)
        print_line(f"{trend.word}  {trend.course.label}: {amount}")
        for line in rest:
            print_line(f"    {line}")
    return 0
