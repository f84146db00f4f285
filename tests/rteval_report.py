"""A report of rteval, written by hand: rteval itself needs a board for itself and packages that Debian does not have.

Its elements, their order and its numbers are those that rteval's code writes (cyclictest.py, rtevalReport.py and
xmlout.py of rteval 3.11), with the spaces of libxml2. Nothing of it was measured.
"""

import math
from collections.abc import Mapping

CPUS = {"0": {2: 3, 3: 400, 4: 90, 11: 1}, "3": {1: 2, 3: 380, 5: 7, 9: 1}}


def report(
    cpus: Mapping[str, Mapping[int, int]] = CPUS,
    *,
    version: str = "3.11",
    profile: bool = False,
    buckets: int = 3500,
    maximum: int = 0,
    stopped_above_us: int | None = None,
) -> str:
    """The text of a report; `profile` is the form before 3.9, `maximum` a largest value beyond the buckets."""
    total: dict[int, int] = {}
    for bins in cpus.values():
        for value, count in bins.items():
            total[value] = total.get(value, 0) + count
    command = f"cyclictest -i100 -qmu -h {buckets} -p95 -t{len(cpus)} -a{','.join(cpus)}"
    lines = [f'<cyclictest command_line="{command}">']
    if stopped_above_us is not None:
        lines.append('  <abort_report reason="breaktrace">')
        lines.append(f'    <breaktrace latency_threshold="{stopped_above_us}" measured_latency="{maximum}"/>')
        lines.append("  </abort_report>")
    lines += _part(f'system description="({len(cpus)} cores) Cortex-A9"', total, buckets, maximum)
    for name, bins in cpus.items():
        lines += _part(f'core id="{name}" priority="95"', bins, buckets, maximum)
    lines.append("  <timestamps>")
    lines.append("    <runloop_start>2026-11-23T10:00:00</runloop_start>")
    lines.append("  </timestamps>")
    lines.append("</cyclictest>")
    return page(lines, version=version, profile=profile)


def page(lines: list[str], *, version: str = "3.11", profile: bool = False) -> str:
    """A report that has these lines among its measurements."""
    if profile:
        lines = ['<Profile loads="1" parallel="1">', *(f"  {line}" for line in lines), "</Profile>"]
    body = "\n".join(f"    {line}" for line in lines)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<rteval version="{version}">
  <run_info days="0" hours="0" minutes="1" seconds="0">
    <date>2026-11-23</date>
    <time>10:00:00</time>
  </run_info>
  <SystemInfo>
    <uname>
      <node>board</node>
      <kernel is_RT="1">6.6.30-rt30</kernel>
      <arch>armv7l</arch>
    </uname>
  </SystemInfo>
  <loads loads="1" load_average="2.41" loadcpus="0-3">
    <command_line name="hackbench" run="1">hackbench -P -g 10 -l 1000 -s 1000</command_line>
  </loads>
  <Measurements measurecpus="0-3">
{body}
  </Measurements>
</rteval>
"""


def _part(tag: str, bins: Mapping[int, int], buckets: int, maximum: int) -> list[str]:
    values = sorted(value for value, count in bins.items() for _ in range(count))
    n = len(values)
    lines = [f"  <{tag}>", "    <statistics>", f"      <samples>{n}</samples>"]
    if n:
        mean = sum(values) / n if n > 1 else 0.0
        deviation = math.fsum(abs(value - mean) for value in values) / n if n > 1 else 0
        variance = math.fsum((value - mean) ** 2 for value in values) / (n - 1) if n > 1 else 0
        stated = {
            "minimum": values[0],
            "maximum": max(values[-1], maximum),
            "median": values[n // 2] if n > 1 else 0.0,
            "mode": max(sorted(bins), key=lambda value: bins[value]) if n > 1 else 0.0,
            "range": values[-1] - values[0] if n > 1 else 0.0,
            "mean": mean,
            "mean_absolute_deviation": deviation,
            "standard_deviation": math.sqrt(variance),
        }
        lines += [f'      <{name} unit="us">{value}</{name}>' for name, value in stated.items()]
    lines.append("    </statistics>")
    if n:
        lines.append(f'    <histogram nbuckets="{buckets}">')
        lines += [f'      <bucket index="{value}" value="{count}"/>' for value, count in sorted(bins.items())]
        lines.append("    </histogram>")
    return [*lines, f"  </{tag.split()[0]}>"]
