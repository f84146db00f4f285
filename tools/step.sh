# shellcheck shell=bash
# step WHAT COMMAND...: one line says what is done and how long it took; what the command prints is shown if it fails.
log=build/setup.log

step() {
    local what=$1 status=0
    shift
    mkdir -p "$(dirname $log)"
    echo "== $(date): $what: $*" >>$log
    printf '%s ... ' "$what"
    SECONDS=0
    "$@" >>$log 2>&1 </dev/null || status=$?
    if [ $status -eq 0 ]; then
        echo "$SECONDS s"
        return
    fi
    echo "failed after $SECONDS s"
    tail -n 20 $log >&2
    echo "tools/${0##*/}: $what: exit status $status; all of its output is in $log" >&2
    exit $status
}
