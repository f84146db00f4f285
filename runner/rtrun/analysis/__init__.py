"""Statistics on int64 nanosecond samples and on histograms: no files, no clock, no printing.

``docs/analysis.md`` has the methods, their sources and limits, and what each method refuses.
"""
