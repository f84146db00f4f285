"""Process groups on the target: one is ended only after a process of it was seen to be what was started.

A number alone says too little. That of a process that has ended is given to another one, a file or an answer that was
cut short holds another number, and ``kill -- -1`` ends everything.
"""

# The first lines of a script that kills groups. It defines `is_ours`, called with the folder of a process below /proc.
FUNCTIONS = """
# Whether a process group has a process that is ours.
is_our_group() {
    [ "$1" -gt 1 ] || return 1
    for process in /proc/[0-9]*; do
        stat=
        # The name may hold anything, brackets and lines too. Behind the last bracket: state, parent, group (proc(5)).
        while IFS= read -r line || [ -n "$line" ]; do stat=$line; done <"$process/stat"
        stat=${stat##*) }
        stat=${stat#* * }
        [ "${stat%% *}" = "$1" ] && is_ours "$process" && return
    done
    return 1
} 2>/dev/null
"""
# supervise.sh holds the lock of a program as file 9, and so does what it starts. `read` fails at a line that has no
# end: it was cut short.
OF_PROGRAM = (
    FUNCTIONS
    + """
is_ours() { [ "$1/fd/9" -ef "$name.lock" ]; }
# Set `group` to that of the program `name`.
find_group() { read -r group <"$name.pid" && is_our_group "$group"; } 2>/dev/null
"""
)
# Programs are looked for among the processes: whatever lies in the folders of runs, those are few. /proc shows the path
# that has no links. Which files a process of another user has open it does not show, but how supervise.sh was called.
LIVING = r"""
# Print the locks below a folder whose programs live, each once.
living() {
    below=$(cd "$1" 2>/dev/null && pwd -P) || return 0
    {
        LC_ALL=C ls -l /proc/[0-9]*/fd/9 2>/dev/null | while IFS= read -r line; do
            lock=${line##* -> }
            case $lock in "$below"/*.lock) echo "$lock" ;; esac
        done
        grep -lF "$below/" /proc/[0-9]*/cmdline 2>/dev/null | while IFS= read -r call; do
            [ -r "${call%cmdline}fd" ] && continue
            lock=$(tr '\0' '\n' <"$call" | sed -n '/\/supervise[.]sh$/{n;N;s,\n,/,;s,$,.lock,p;q;}')
            case $lock in "$below"/*) flock -n -s "$lock" true || echo "$lock" ;; esac
        done 2>/dev/null
    } | sort -u
}
"""
