#!/bin/sh
# Print the processes that map a file whose path matches, and their threads. probes/programs.py reads it.
#
#   find_programs.sh PATTERN [-]     PATTERN as of grep -E; with -, standard input names the processes, a pid a line
#
# For each process, between lines "program PID" and "end PID": parts of its files in /proc, each line behind a word that
# says of which. What ends meanwhile has less of them. Names and arguments are bytes of any kind and, some of them, any
# length: what comes from them is cut, and each of its lines has its word in front.
pattern=$1
export LC_ALL=C
case ${2-} in
-) cat ;;
*) for process in /proc/[0-9]*; do echo "${process#/proc/}"; done ;;
esac | sed 's,.*,/proc/&/maps,' | xargs grep -lsE -- "$pattern" | while IFS=/ read -r _ _ pid _; do
    cd "/proc/$pid" || continue
    echo "program $pid"
    # An argument is a line, in which a newline is the character 1: "argument", or "cut" with its beginning. What names
    # a node is whole wherever it stands, of the others there are the first 4096 bytes. The arguments of a program may
    # be some MiB; more than 16 MiB are read of none.
    dd bs=65536 count=256 <cmdline | tr '\0\n' '\n\001' | awk '
        BEGIN { room = 4096 }
        length($0) <= 1024 && /^([^:=]*:)?__(node|name|ns):=/ && names++ < 16 { print "argument " $0; next }
        room > 0 { print (length($0) <= room ? "argument " : "cut ") substr($0, 1, room) }
        room <= 0 && !told++ { print "cut " }
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
