"""The bounds of numbers in files and in answers of a target: a type for each quantity, for its writers and readers.

If the kernel has a bound, that is used. The other bounds lie far above what is measured, and low enough that results of
computing with such numbers fit into 64 bits. The bounds of a suite's options are in suites.yml.
"""

from typing import Annotated, TypeVar

from pydantic import Field

from rtfiles.untrusted import INT64_MAX

# 31 years. A series is the sum of four times at most, and the difference of two of its values still fits into 64 bits.
TIME_MAX_NS = 10**18
# ros::Time counts seconds since 1970 in 32 bits. Times of the wall clock are never added up, only subtracted.
WALL_TIME_MAX_NS = 2**32 * 10**9
UPTIME_MAX_S = TIME_MAX_NS // 10**9
# A measurement every 100 us for three years.
COUNT_MAX = 10**12
# A clock that steps less often measures nothing.
CLOCK_STEP_MAX_NS = 10**9
SIZE_MAX_BYTES = 2**50
PID_MAX = 2**22  #: the number of a process on the target (PID_MAX_LIMIT of the kernel)
# The kernel builds with at most 8192 CPUs (CONFIG_NR_CPUS); numbers in data files have at most four digits.
CPUS_MAX = 8192  #: CPU numbers in a CPU list
# sched_get_priority_max(2).
RT_PRIORITY_MAX = 99
# For measuring threads: the ROS master needs the priority above theirs (thesis 4.4), and 99 belongs to the kernel.
MEASURING_PRIORITY_MAX = 97
# In both directions: a sensor without a reading may report -274 degrees (THERMAL_TEMP_INVALID), a broken one anything.
TEMPERATURE_MAX_MC = 1_000_000
FREQUENCY_MAX_KHZ = 10**8
# sched_rt_runtime_us is an int of C; -1 stands for no limit.
RT_RUNTIME_MAX_US = 2**31 - 1
# max_cfs_runtime of the kernel. Its longest period is a second; that of real-time threads may be RT_RUNTIME_MAX_US.
QUOTA_MAX_US = 2**44
EXIT_STATUS_MAX = 255
# Rows of a run in an archive's table of histograms: one for each step of the clock with a value. 100 MB in memory.
BINS_MAX = 2**22  #: bins of a run in an archive
# The kernel's PM QoS holds it in an int of C.
CPU_DMA_LATENCY_MAX_US = 2**31 - 1
# Once in a nanosecond.
RATE_MAX_HZ = 10**9

TimeNs = Annotated[int, Field(ge=-TIME_MAX_NS, le=TIME_MAX_NS)]
CpuTimeNs = Annotated[int, Field(ge=0, le=TIME_MAX_NS)]
MeanNs = Annotated[float, Field(ge=-TIME_MAX_NS, le=TIME_MAX_NS)]
PeriodNs = Annotated[float, Field(gt=0, le=TIME_MAX_NS)]
ClockStepNs = Annotated[int, Field(ge=0, le=CLOCK_STEP_MAX_NS)]
UptimeS = Annotated[float, Field(ge=0, le=UPTIME_MAX_S)]
Count = Annotated[int, Field(ge=0, le=COUNT_MAX)]
SizeBytes = Annotated[int, Field(ge=0, le=SIZE_MAX_BYTES)]
Seed = Annotated[int, Field(ge=0, le=INT64_MAX)]
Pid = Annotated[int, Field(ge=1, le=PID_MAX)]
Priority = Annotated[int, Field(ge=0, le=RT_PRIORITY_MAX)]
Cpu = Annotated[int, Field(ge=0, lt=CPUS_MAX)]
CpuCount = Annotated[int, Field(ge=1, le=CPUS_MAX)]
TemperatureMc = Annotated[int, Field(ge=-TEMPERATURE_MAX_MC, le=TEMPERATURE_MAX_MC)]
FrequencyKhz = Annotated[int, Field(ge=0, le=FREQUENCY_MAX_KHZ)]
# There are no more threads than pids.
LoadAverage = Annotated[float, Field(ge=0, le=PID_MAX)]
RtRuntimeUs = Annotated[int, Field(ge=-1, le=RT_RUNTIME_MAX_US)]
QuotaUs = Annotated[int, Field(ge=1, le=QUOTA_MAX_US)]
PeriodUs = Annotated[int, Field(ge=1, le=RT_RUNTIME_MAX_US)]
CpuDmaLatencyUs = Annotated[int, Field(ge=0, le=CPU_DMA_LATENCY_MAX_US)]
RateHz = Annotated[float, Field(ge=0, le=RATE_MAX_HZ)]
ExitStatus = Annotated[int, Field(ge=0, le=EXIT_STATUS_MAX)]

NumberT = TypeVar("NumberT", int, float)
Percent = Annotated[NumberT, Field(ge=0, le=100)]
Range = Annotated[list[NumberT], Field(min_length=2, max_length=2)]
"""The lowest and the highest value."""
