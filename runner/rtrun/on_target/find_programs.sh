#!/bin/sh
# Print the processes that map a file whose path matches, those with threads that find_threads.sh finds, and the threads of
# all of them. probes/programs.py reads it.
#
#   find_programs.sh PATTERN [NAMES]   PATTERN as of grep -E; NAMES as of find_threads.sh
#   find_programs.sh PATTERN -         standard input names the processes, a pid a line
#
# For each process, between lines "program PID" and "end PID": parts of its files in /proc, each line behind a word that
# says of which. What ends meanwhile has less of them. Names and arguments are bytes of any kind and, some of them, any
# length: what comes from them is cut, and each of its lines has its word in front.
pattern=$1
export LC_ALL=C
case ${2-} in
-) cat ;;
*)
    processes=$(printf '%s\n' /proc/[0-9]*)
    {
        printf '%s\n' "$processes" | sed 's,$,/maps,' | xargs grep -lsE -- "$pattern" | sed 's,^/proc/\([0-9]*\)/.*,\1,'
        printf '%s\n' "$processes" | "${0%/*}/find_threads.sh" "${2-}" | sed 's, .*,,'
    } | sort -un
    ;;
esac | while read -r pid; do
    cd "/proc/$pid" || continue
    echo "program $pid"
    # Its name without the folder: a newline is the character 1, as in arguments.
    file=$(readlink exe) && printf 'file %s\n' "$(printf '%s' "${file##*/}" | tr '\n' '\001')"
    # An argument is a line, in which a newline is the character 1: "argument", or "cut" with its beginning. What names
    # a node is whole wherever it stands, of the others there are the first 4096 bytes. The arguments of a program may
    # be some MiB; more than 16 MiB are read of none.
    dd bs=65536 count=256 <cmdline | tr '\0\n' '\n\001' | awk '
        BEGIN { room = 4096 }
        length($0) <= 1024 && /^([^:=]*:)?__(node|name|ns):=/ && names++ < 16 { print "argument " $0; next }
        room > 0 { print (length($0) <= room ? "argument " : "cut ") substr($0, 1, room) }
        room <= 0 && !cuts++ { print "cut " }
        { room -= length($0) + 16 }'
    sed -n 's/^VmLck:[[:blank:]]*/locked /p' status
    sed 's/^/stat /' task/[0-9]*/stat
    grep -sH '^Cpus_allowed_list:' task/[0-9]*/status | sed 's,^task/\([0-9]*\)/[^:]*:Cpus_allowed_list:,cpus \1 ,'
    # Each file once. A path that is too long to be opened keeps its end, which tells the library.
    grep -E -- "$pattern" maps | awk '
        $2 ~ /^..xp/ {
            path = substr($0, index($0, "/"))
            if (length(path) > 4096) path = "/..." substr(path, length(path) - 1024)
            if (!seen[$4, $5, path]++ && files++ < 16) print "maps", $1, $4, $5, path
        }'
    echo "end $pid"
done 2>/dev/null
exit 0
