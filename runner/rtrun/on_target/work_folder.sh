#!/bin/sh
# Make the runner's folder on the target, once it is certain that nobody else can change what is run from there. What
# stands against that is printed: "unsafe WHY", "foreign PATH" or "readonly PATH". Nothing: it is ready.
#   work_folder.sh WORK_DIR
# Every folder and link on the way has to belong to root or to this user, and nobody else may write to it. A look is enough,
# because what was seen stays: from the root down, a name in such a folder can be given another meaning by these two alone.
# In a sticky folder, as /tmp, others may add names, but not rename or remove one of ours. A folder that is missing there
# may be made by another user in the same moment: mkdir takes none that exists, and who made it is seen afterwards. What
# the folder holds must be ours, too: it may have been put there while others could write to it.
set -f
umask go-w
export LC_ALL=C
me=$(id -u)
work=$1
# That of busybox does not show a list of rights (ACL), by which others may write where the group may.
shows_lists=
case $(ls --version 2>/dev/null) in *coreutils*) shows_lists=1 ;; esac

refuse() {
    echo "$*"
    exit 0
}
# private OWNER GROUP: the group has no member but its owner, as the group of the same number that users get.
private() {
    [ "$1" = "$2" ] || return 1
    names=, known=
    while IFS=: read -r name _ uid gid _ || [ -n "$name" ]; do
        [ "$uid" != "$1" ] || names=$names$name,
        [ "$gid" != "$2" ] || [ "$uid" = "$1" ] || return 1
    done </etc/passwd
    while IFS=: read -r _ _ gid members || [ -n "$gid" ]; do
        [ "$gid" = "$2" ] || continue
        # A number may stand in several lines, each with members of its own.
        known=1
        while [ -n "$members" ]; do
            case $names in *",${members%%,*},"*) ;; *) return 1 ;; esac
            case $members in *,*) members=${members#*,} ;; *) break ;; esac
        done
    done </etc/group
    [ -n "$known" ]
}
# objection MODE OWNER GROUP: sets $why where others can change what ls shows so.
objection() {
    why=
    case $2 in
    0 | "$me") ;;
    *)
        why="belongs to user $2"
        return
        ;;
    esac
    case $1 in
    l*) ;;
    ????????w*) why="can be written by every user" ;;
    # Of a list of rights (+) these are the ones that any other user or group may have by it.
    ?????w????+) why="can be written by others (getfacl)" ;;
    ?????w*) [ -n "$shows_lists" ] && private "$2" "$3" || why="can be written by group $3" ;;
    esac
}

# The user who mounted a FUSE file system chooses what it says of its files. No file in it is looked at.
nl='
'
served=$nl$(
    while read -r _ _ _ _ at rest; do
        case ${rest##* - } in fuse*user_id=*) ;; *) continue ;; esac
        user=${rest##*user_id=}
        case ${user%%,*} in 0 | "$me") ;; *) printf '%b\n' "$at" ;; esac
    done </proc/self/mountinfo
)$nl

way=/$work/ at='' links=0
while [ -n "$way" ]; do
    name=${way%%/*} way=${way#*/}
    case $name in
    '' | .) [ -z "$at" ] || continue ;;
    ..)
        at=${at%/*}
        continue
        ;;
    esac
    place=$at/$name
    case $served in *"$nl$place$nl"*) refuse "unsafe $place is a file system (FUSE) of another user" ;; esac
    [ -e "$place" ] || [ -L "$place" ] || mkdir -m 755 "$place" 2>/dev/null || [ -e "$place" ] || refuse "readonly $place"
    # shellcheck disable=SC2046 # the words of the line are wanted
    set -- $(ls -ldn "$place")
    objection "$1" "$3" "$4"
    case $1 in
    l*)
        [ -z "$why" ] || refuse "unsafe $place is a link that $why"
        [ $((links += 1)) -le 40 ] || refuse "unsafe more than 40 links lead there"
        to=$(readlink "$place")
        way=$to/$way
        case $to in /*) at='' ;; esac
        continue
        ;;
    d*) ;;
    *) refuse "unsafe $place is no folder" ;;
    esac
    # Nobody but its owner, root and the owners of the names in it changes a sticky folder on the way.
    case $1,$why in ?????????[tT]*,can*) why='' ;; esac
    [ -z "$why" ] || refuse "unsafe $place $why"
    at=${place%/}
done
# Where the way ends, by whatever turns, others must not even add names.
# shellcheck disable=SC2046
set -- $(ls -ldn "$at/")
objection "$1" "$3" "$4"
[ -z "$why" ] || refuse "unsafe ${at:-/} $why"

# The runner removes folders in its working folder: it must be new, empty, or known by the mark. One of a version without
# a mark is known by its names.
set +f
mark=$work/.rt-tests
for entry in "$work"/* "$work"/.[!.]*; do
    [ ! -e "$mark" ] || break
    [ -e "$entry" ] || [ -L "$entry" ] || continue
    case ${entry##*/} in
    objects | suites | scripts | runs | master) [ -L "$entry" ] || continue ;;
    esac
    refuse "foreign $entry"
done
set -f
why=$(
    ls -lnAR "$work/" 2>/dev/null | while read -r mode _ owner group _; do
        case $mode in
        [-dlbcps][r-][w-]???????*) objection "$mode" "$owner" "$group" ;;
        *) continue ;;
        esac
        [ -z "$why" ] || {
            echo "$why"
            break
        }
    done
)
[ -z "$why" ] || refuse "unsafe $work holds something that $why"
mkdir -p "$work/objects" "$work/suites" "$work/runs" "$work/master" 2>/dev/null && [ -w "$work" ] && (: >>"$mark") 2>/dev/null ||
    refuse "readonly $work"
# A default list of rights, which chmod leaves as it is, gives others what is made there, whatever the umask says.
# Another rtrun may ask the same at the same time.
probe=$work/.probe-$$
rmdir "$probe" 2>/dev/null
mkdir "$probe" || refuse "readonly $work"
# shellcheck disable=SC2046
set -- $(ls -ldn "$probe")
rmdir "$probe"
case $1 in ?????w* | ????????w*) refuse "unsafe $work gives others the right to write to what is made there (getfacl)" ;; esac
