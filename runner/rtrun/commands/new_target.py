"""``rtrun new-target``: from the name of a board to a target file that works."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rtrun.targets.address import Address
    from rtrun.targets.link import Link

HELP = "write the target file of a board, after a look at its host key, and say what the board lacks"
EXAMPLES = (
    "rtrun new-target",
    "rtrun new-target --host robot.local --user root --name robot",
)
HOST_KEY_S = 15.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--host", help="name or address of the board, or an alias of ~/.ssh/config [asked for]")
    parser.add_argument("--user", help="[User of ~/.ssh/config, else root]")
    parser.add_argument("--port", type=int, help="[Port of ~/.ssh/config, else 22]")
    parser.add_argument("--key", metavar="FILE", help="private key to log in with [as ssh would choose]")
    parser.add_argument(
        "--host-key", metavar="SHA256:...", help="fingerprint that the board must show [known_hosts, else asked for]"
    )
    parser.add_argument("--name", help="name of the target, for the results [that of the host]")
    parser.add_argument("--output", type=Path, metavar="TARGET.yml", help="file to write [NAME.yml]")


def run(args: argparse.Namespace) -> int:
    """Write the file and print what the board lacks. 0: written, 3: the board is out of reach or was refused."""
    import sys

    from rtfiles.errors import UsageError
    from rtfiles.output import print_line
    from rtrun.commands._link import linked
    from rtrun.targets.config import parse_target, target_name
    from rtrun.targets.ssh.ssh_config import address_of

    asks = sys.stdin.isatty()
    host = args.host or (_answer("host (name, address, or alias of ~/.ssh/config)") if asks else "")
    if not host:
        raise UsageError("new-target: no host: give --host, or call it on a terminal, where it asks")
    key = args.key or (_answer("private key file (empty: as ssh would choose)") if asks and not args.host else "")
    name = args.name or target_name(host) or "board"
    output: Path = args.output or Path(f"{name}.yml")
    if output.exists():
        raise UsageError(f"{output}: exists already: name another file with --output")
    values: dict[str, Any] = {"schema": 1, "name": name, "kind": "ssh", "host": host, "user": args.user}
    values |= {"port": args.port, "key": _from_anywhere(key), "host_key": args.host_key}
    values = {key: value for key, value in values.items() if value not in (None, "")}
    # Before any network access: an error here is reported in the words of target files.
    parse_target(values, "new-target")
    if not args.host_key:
        address = address_of(host, user=args.user, port=args.port, key=Path(key) if key else None)
        values |= _host_key(address, asks)

    with linked(parse_target(values, "new-target"), Path.cwd()) as link:
        values |= _kernels(link)
        _write(output, values)
        print_line(f"{output}: target {name} ({link.target.address})")
        lacks = _lacks(link, output)
        print_line(_readiness(link, output))
    for line in lacks:
        print_line(f"the board lacks {line}")
    return 0


def _answer(question: str) -> str:
    """Ask on the terminal; an empty answer is allowed."""
    from rtfiles.errors import UsageError

    try:
        return input(f"{question}: ").strip()
    except EOFError as error:
        raise UsageError("new-target: the question was not answered") from error


def _from_anywhere(path: str) -> str:
    """A path that means the same in a target file, wherever that file is."""
    return path if not path or path.startswith("~") else str(Path(path).absolute())


def _host_key(address: "Address", asks: bool) -> dict[str, str]:
    """Return the host key for the target file, once the user has compared it; empty where known_hosts has the key."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line
    from rtrun.targets.errors import TargetError
    from rtrun.targets.ssh.host_keys import fingerprint, read_host_keys
    from rtrun.targets.ssh.transport import ask_host_key

    known = read_host_keys(address)
    if known.trusted or known.authorities:
        return {}
    kind, blob = ask_host_key(address, HOST_KEY_S)
    shown = fingerprint(blob)
    file = {"ssh-ed25519": "ed25519", "ssh-rsa": "rsa"}.get(kind, "ecdsa")
    compare = f"compare it with what the board's own console says: ssh-keygen -lf /etc/ssh/ssh_host_{file}_key.pub"
    if not asks:
        raise TargetError(f"{address}: unknown host key {shown} ({kind}): {compare}; then add --host-key {shown}")
    print_line(f"{address} shows the host key {shown} ({kind})")
    print_line(compare)
    answer = _answer("is it the board's? (yes, or the fingerprint that the board says)")
    if answer not in ("yes", shown):
        raise UsageError("new-target: the host key was not accepted: nothing was written")
    return {"host_key": shown}


def _kernels(link: "Link") -> dict[str, Any]:
    """Return how to restart the board into each of its kernels, if it has our cards' command boot-kernel."""
    from typing import get_args

    from rtrun.plan.run import KernelName

    listed = link.run(["sh", "-c", "boot-kernel 2>/dev/null"])
    kernels = [name for name in get_args(KernelName) if listed.status == 0 and name in listed.stdout.split()]
    if not kernels:
        return {}
    return {"restart": ["reboot"], "boot_kernel": {name: ["boot-kernel", name] for name in kernels}}


def _write(output: Path, values: dict[str, Any]) -> None:
    import yaml

    from rtfiles import atomic

    atomic.write_named(output, yaml.safe_dump(values, sort_keys=False, allow_unicode=True).encode())


def _lacks(link: "Link", file: Path) -> list[str]:
    """Return what the board of a target file lacks for campaigns."""
    import shlex

    from rtfiles.invocation import as_called
    from rtrun.plan import conditions, suites
    from rtrun.targets.errors import TargetError
    from rtrun.targets.inspection import facts as inspection
    from rtrun.targets.link import OUT_OF_REACH

    lacks = []
    try:
        equipment = inspection.inspect(link)
    except OUT_OF_REACH:
        raise
    except TargetError as error:
        lacks.append(f"something that every campaign needs: {error}")
    else:
        if equipment.installed("roscpp").server is None:
            lacks.append("ROS 1: neither /opt/ros/*/bin/rosmaster nor /usr/bin/rosmaster is there")
        needed = {program for suite in suites.suites().suites.values() for program in suite.programs}
        if missing := sorted(needed - set(equipment.programs)):
            lacks.append(
                f"{', '.join(missing)}: build them there with {as_called('rtgen')} suites build --on "
                f"{shlex.quote(str(file))}, or here, where it has no compiler (docs/targets.md)"
            )
    tools = {program for baseline in suites.baselines().suites.values() for program in baseline.programs}
    for name in conditions.conditions().conditions:
        tools |= conditions.needs(name, {})
    priority = f"rt_priority={suites.options()['priority'].default}"
    answer = inspection.missing(link, [*sorted(tools), priority])
    if missing := [line for line in answer if line in tools]:
        lacks.append(f"{', '.join(missing)}, for the loads and yardsticks of campaigns (packages rt-tests, stress-ng)")
    return lacks + [line for line in answer if line not in tools]


def _readiness(link: "Link", output: Path) -> str:
    """State in one line what prevents real time."""
    from rtfiles.invocation import as_called
    from rtrun.targets.inspection import rt_readiness

    findings = rt_readiness.judge(rt_readiness.read_checks(), rt_readiness.read_facts(link))
    grave = [fault.check.name for fault in rt_readiness.grave_faults(findings)]
    if not grave:
        return "nothing grave stands in the way of real time"
    explain = f"{as_called('rtrun')} check-rt --target {output}"
    return f"in the way of real time: {', '.join(grave)}; {explain} says why, and the remedy"
