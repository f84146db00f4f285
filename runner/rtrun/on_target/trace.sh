#!/bin/sh
# The kernel trace that the suites copy from around an outlier: an instance of its own, so that nobody else's is touched.
#
#   trace.sh up CLOCK EVENT...    set up, unless it is there already; CLOCK as in trace_clock: mono_raw, mono;
#                                 EVENT below `events`, left out where the kernel does not have it
#   trace.sh down                 take down; one that a suite still uses stays, and so does for a minute what a campaign
#                                 with another directory on this target has set up, which is about to use it
set -u
tracing=/sys/kernel/tracing
instance=$tracing/instances/rtrun
osnoise=$tracing/osnoise/options
# There while osnoise does without its workload because of us: it is the option of everybody, and goes with a reboot.
changed=/run/rtrun-osnoise
# Whose trace it is: the directory of a campaign on this target.
owner=/run/rtrun-trace-of
own=$(cd "${0%/*}/.." && pwd)

is_anothers() {
    [ "$(cat $owner 2>/dev/null)" != "$own" ] && [ -z "$(find $instance -maxdepth 0 -mmin +1)" ]
}

down() {
    if [ -d $instance ] && is_anothers; then return; fi
    [ ! -d $instance ] || rmdir $instance 2>/dev/null || return 0
    [ ! -e $changed ] || { echo OSNOISE_WORKLOAD >$osnoise; rm -f $changed; }
}

fail() {
    down
    echo "$1" >&2
    exit 1
}

up() {
    [ -d $tracing/instances ] || mount -t tracefs tracefs $tracing 2>/dev/null ||
        fail "no kernel trace: it needs CONFIG_FTRACE, tracefs on $tracing, and root"
    if [ -d $instance ]; then
        # A run that is picked up again finds its trace as it was.
        grep -q "\[$1\]" $instance/trace_clock && return
        down
        [ ! -d $instance ] || { echo "the kernel trace is in use by another run" >&2; exit 1; }
    fi
    echo "$own" >$owner
    mkdir -p $instance || fail "no kernel trace: $instance cannot be made"
    echo "$1" >$instance/trace_clock || fail "no kernel trace: the kernel has no trace clock $1"
    shift
    # For each CPU: some tenths of a second of a busy one.
    echo 512 >$instance/buffer_size_kb
    # Where osnoise can do without its workload, which would keep every CPU busy: its events.
    if grep -qw OSNOISE_WORKLOAD $osnoise 2>/dev/null; then
        : >$changed && echo NO_OSNOISE_WORKLOAD >$osnoise
    fi
    if grep -qw NO_OSNOISE_WORKLOAD $osnoise 2>/dev/null; then echo osnoise >$instance/current_tracer; fi
    for event; do
        if [ -e "$instance/events/$event/enable" ]; then echo 1 >"$instance/events/$event/enable"; fi
    done
    # Memory for snapshots is taken now rather than at the first outlier.
    if [ -e $instance/snapshot ]; then
        echo 1 >$instance/snapshot && echo 2 >$instance/snapshot
    fi
    echo 1 >$instance/tracing_on
}

case $1 in
    up) shift && up "$@" ;;
    down) down ;;
esac
