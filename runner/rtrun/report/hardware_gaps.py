"""The gaps that hwlatdetect found, next to the values of a campaign: no trace shows them, and no priority helps."""

from rtfiles.output import counted
from rtfiles.quantities import time
from rtrun.judgement.study import Study
from rtrun.plan.campaign import GAP_SEARCH
from rtrun.report.tables import Table
from rtrun.results.record import RunStatus
from rtrun.validity.baselines import HardwareGaps, read_gaps
from rtrun.validity.observations import read_text


def hardware_gaps(study: Study) -> Table:
    """A row for each run of hwlatdetect that counts."""
    folders = {folder.name: folder for folder in study.source.folders}
    rows, gaps = [], []
    for record in study.records:
        if record.suite != GAP_SEARCH or record.status is not RunStatus.OK or record.run not in folders:
            continue
        found = read_gaps(read_text(folders[record.run] / f"{GAP_SEARCH}.stdout"))
        if found is None:
            continue
        asked = (f"{record.parameters.get(key)} {unit}" for key, unit in (("duration_s", "s"), ("threshold_us", "us")))
        longest = time(1000 * found.longest_us) if found.longest_us else "-"
        rows.append((record.run, record.target.name, record.condition, *asked, str(found.found), longest))
        gaps.append(found)
    return Table(
        id="hardware-gaps",
        title="Gaps of the hardware",
        columns=("run", "target", "condition", "watched for", "gaps above", "found", "longest"),
        rows=rows,
        outcome=_outcome(gaps),
        numbers=range(3, 7),
        notes=(
            "In a gap the firmware or the hardware has the CPU: what is due then is late by as much, whatever its "
            "priority, and no trace shows why. By default hwlatdetect watches half of each second, on one CPU at a "
            "time: that it found none does not mean that there is none.",
        ),
    )


def _outcome(gaps: list[HardwareGaps]) -> str:
    some = [run for run in gaps if run.found]
    if not some:
        return f"none found in {counted(len(gaps), 'run')}"
    longest = time(1000 * max(run.longest_us for run in some))
    return f"the longest {longest}, in {len(some)} of {counted(len(gaps), 'run')}"
