"""Order: do values or misses stay the same over a run, from run to run, and from boot to boot?"""
