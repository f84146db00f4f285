"""Verify with the kernel's own ``conf`` that each line of a fragment takes effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.untrusted import read_text
from rtfiles.wording import did_you_mean
from rtgen.kconfig import explain
from rtgen.kconfig.data import Basis, Data
from rtgen.kconfig.fragment import CONFIG_BYTES_MAX, Line, kernel_of, parse, parse_defconfig, parse_fragment, values
from rtgen.kconfig.render import config_line
from rtgen.kconfig.tree import ARCHITECTURES, Architecture, Tree, run_conf


@dataclass(frozen=True, kw_only=True, slots=True)
class Mismatch:
    """A symbol whose value is not the wanted one, and why."""

    symbol: str
    want: str
    got: str
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Verification:
    """The result for `checked` options on one base; `config` is the finished .config."""

    subject: str
    checked: int
    mismatches: tuple[Mismatch, ...]
    config: str


def read_base(data: Data, tree: Tree, architecture: Architecture, name: str) -> tuple[Line, ...]:
    """A base of a machine: a file in ``bases/``, or a defconfig of the tree. Raises UsageError."""
    own = data.folder / "bases" / name
    path = own if own.is_file() else tree.defconfig(name, architecture)
    return parse_defconfig(read_text(path, max_bytes=CONFIG_BYTES_MAX), name if path != own else str(own))


def merge(base: Sequence[Line], fragment: Sequence[Line]) -> str:
    """A base with a fragment merged onto it, as the text of a defconfig. The fragment overrides the base."""
    overridden = {line.symbol for line in fragment}
    kept = [line for line in base if line.symbol not in overridden]
    return "".join(f"{config_line(line.symbol, line.value)}\n" for line in [*kept, *fragment])


def verify_tree(
    data: Data,
    tree: Tree,
    machine: str,
    base: str,
    fragment: Sequence[Line],
    origin: str | None,
    selected: str | None = None,
) -> Verification:
    """Merge a fragment onto a base of the machine, and compare the .config of ``conf`` with fragment and data.

    Options of the data count even if the fragment leaves them out or contradicts them. `origin` names the file of the
    fragment, None for the rendered fragment; `selected` is as in `Data.basis`.
    """
    basis = data.basis(tree.kernel, selected)
    architecture = ARCHITECTURES[data.machine(machine).architecture]
    given = values(tuple(fragment))
    wanted = given | data.wanted(machine, basis.options_of)
    config = run_conf(tree, architecture, merge(read_base(data, tree, architecture, base), fragment))
    got = values(parse(config, ".config"))
    known = tree.symbols(architecture)
    wrong = {name: value for name, value in wanted.items() if name not in known or got.get(name, "n") != value}
    reasons = explain.explain(
        tree, architecture, config, {name: value for name, value in wrong.items() if name in known}
    )
    mismatches = []
    for name, value in wrong.items():
        if name not in known:
            hint = did_you_mean([name], sorted(known))
            why = f"undefined symbol in {tree.name}{',' if hint else ''}{hint}"
        else:
            why = reasons.get(name, "no explanation: kconfiglib sees no difference")
            if origin and name not in given:
                why = f"not in {origin}; {why}"
            elif origin and given[name] != value:
                number = next(line.number for line in fragment if line.symbol == name)
                why = f"{origin}:{number} says {given[name]}; {why}"
        series = data.rt_series(machine, basis.rt_of)
        if series and name == data.kernel(basis.rt_of).rt_symbol and (name not in known or "ARCH_SUPPORTS_RT" in why):
            why = f"this tree lacks the patch series {series} ({why})"
        mismatches.append(Mismatch(symbol=name, want=value, got=_shown(name, got, known), reason=why))
    return Verification(
        subject=f"{machine}, Linux {tree.release}{basis.remark(tree.kernel)}, {base}",
        checked=len(wanted), mismatches=tuple(mismatches), config=config,
    )  # fmt: skip


def rendered(data: Data, machine: str, basis: Basis) -> tuple[Line, ...]:
    """What the fragment of a machine sets, for a kernel of any version."""
    wanted = data.wanted(machine, basis.options_of)
    return tuple(Line(symbol, value, number) for number, (symbol, value) in enumerate(wanted.items(), start=1))


def verify_config(data: Data, machine: str, text: str, origin: str, selected: str | None = None) -> Verification:
    """Compare a finished .config with the data; `selected` is as in `Data.basis`.

    Raises UsageError when its head names no kernel version.
    """
    kernel = kernel_of(text)
    if kernel is None:
        raise UsageError(
            f"{origin}:1: not a finished .config, "
            "its head must be '# Linux/<architecture> <version> Kernel Configuration'"
        )
    basis = data.basis(kernel, selected)
    wanted = data.wanted(machine, basis.options_of)
    got = values(parse(text, origin))
    mismatches = tuple(
        Mismatch(symbol=name, want=value, got=got.get(name, "n"), reason=_why_not(data, machine, basis, name))
        for name, value in wanted.items()
        if got.get(name, "n") != value
    )
    return Verification(
        subject=f"{machine}, Linux {kernel}{basis.remark(kernel)}, {origin}",
        checked=len(wanted), mismatches=mismatches, config=text,
    )  # fmt: skip


def load_fragment(path: Path) -> tuple[Line, ...]:
    """Read a fragment. Raises UsageError for a malformed or repeated line, with file and line."""
    return parse_fragment(read_text(path, max_bytes=CONFIG_BYTES_MAX), str(path))


def _shown(name: str, got: Mapping[str, str], known: frozenset[str]) -> str:
    return got.get(name, "n" if name in known else "nothing")


def _why_not(data: Data, machine: str, basis: Basis, symbol: str) -> str:
    options = (option for group in data.options(machine, basis.options_of).values() for option in group)
    return next(option.reason for option in options if option.symbol == symbol)
