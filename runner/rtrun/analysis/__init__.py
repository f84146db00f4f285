"""Statistics on int64 nanosecond samples and on histograms: no files, no clock, no printing.

Methods, their sources, limits and what each refuses stand in ``docs/analysis.md``.
"""
