"""rtrun claims: what the campaign shows for each of the 19 claims of the thesis."""

import argparse

from rtrun.commands._arguments import add_json, add_results
from rtrun.commands._question import add_confidence

HELP = "re-examine the 19 claims of the thesis on a campaign"
EXAMPLES = (
    "rtrun claims results/thesis-2014",
    "rtrun claims results/thesis-2014 --json",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_results(parser, files=False)
    add_json(parser)
    add_confidence(parser)


def run(args: argparse.Namespace) -> int:
    """Print the claims. Raises UsageError when there is nothing to examine."""
    import dataclasses

    from rtfiles.output import console, listed, print_json, print_line
    from rtrun.judgement.study import study
    from rtrun.plan.question import THESIS
    from rtrun.report.screen import print_styled
    from rtrun.report.terminal import print_banner
    from rtrun.thesis.examiners import examine_claims
    from rtrun.thesis.published import published_figures

    analysed = study(args.results, dataclasses.replace(THESIS, confidence=args.confidence), bounds=False)
    examined, published = examine_claims(analysed), published_figures(analysed)
    if args.json:
        claims = [dataclasses.asdict(claim) for claim in examined]
        print_json({"schema": 2, "platform": analysed.platform, "claims": claims, "published": published.as_data()})
        return 0
    print_banner(analysed.platform, analysed.preempt_rt)
    for claim in examined:
        result = claim.result
        print_styled(result.finding, f"{' ' * (9 - len(result.finding))}  {claim.id} ({claim.section}): {claim.text}")
        print_line(f"           {result.numbers}")
        if result.runs:
            shown = listed(result.runs, 4)
            print_line(f"           test: {result.test}; runs: {shown}")
    if published.rows:
        print_line(f"{published.title}: {published.outcome}")
        console().print(published)
        for text in published.notes:
            print_line(text)
    for text in analysed.left_out:
        print_line(f"not analysed: {text}")
    return 0
