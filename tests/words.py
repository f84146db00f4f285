"""Words that a native engineer would not write, found in pages and comments: words.tsv has the better ones.

    python tests/words.py [FILE...]      # without a name, all files that git knows

Exit status 1 where there is one.
"""

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIST = Path(__file__).with_name("words.tsv")
# Comments begin so, in files of these kinds.
COMMENTS = {
    **dict.fromkeys((".sh", ".yml", ".yaml", ".toml", ".cmake", ".bb", ".bbappend", ".inc", ".conf", ".cfg"), "#"),
    **dict.fromkeys((".c", ".h", ".cpp", ".hpp"), "//"),
}


def patterns() -> list[tuple[re.Pattern[str], str]]:
    """Each pattern with what to write instead."""
    rows = [line.split("\t") for line in LIST.read_text().splitlines() if line and not line.startswith("#")]
    return [(re.compile(pattern, re.IGNORECASE), better) for pattern, better in rows]


def prose(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """What people read of a file, by lines: of a page all but code, of a program its comments."""
    if path.suffix == ".md":
        yield from _of_page(text)
    elif path.suffix == ".py":
        yield from _of_python(text)
    else:
        mark = COMMENTS.get(path.suffixes[0] if path.suffix == ".j2" and path.suffixes else path.suffix)
        mark = mark or ("#" if text.startswith("#!") or path.name == "Makefile" else None)
        comment = re.compile(r"(?:^|\s)#(.*)" if mark == "#" else r"//(.*)|/\*(.*)|^\s*\*(.*)")
        for number, line in enumerate(text.splitlines() if mark else (), 1):
            if match := comment.search(line):
                yield number, next(part for part in match.groups() if part is not None)


def _of_page(text: str) -> Iterator[tuple[int, str]]:
    is_code = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            is_code = not is_code
        elif not is_code and not line.startswith("    "):
            yield number, re.sub(r"`[^`]*`", "", line)


def _of_python(text: str) -> Iterator[tuple[int, str]]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    for node in ast.walk(ast.parse(text)):
        # A docstring, also of an attribute.
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            for number, line in enumerate(node.value.value.splitlines(), node.lineno):
                yield number, re.sub(r"`[^`]*`", "", line)


def found(paths: list[Path]) -> Iterator[str]:
    """A line for each of these words."""
    listed = patterns()
    for path in paths:
        try:
            text = path.read_text()
        except (UnicodeDecodeError, FileNotFoundError, IsADirectoryError):
            continue
        for number, line in prose(path, text):
            for pattern, better in listed:
                if match := pattern.search(line):
                    name = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
                    yield f"{name}:{number}: '{match[0]}': write instead: {better}"


def main() -> int:
    names = sys.argv[1:] or subprocess.run(
        ["git", "-C", ROOT, "ls-files", "-z"], check=True, capture_output=True, text=True
    ).stdout.split("\0")
    lines = list(found([ROOT / name for name in names if name]))
    print(*lines, sep="\n", end="\n" if lines else "")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
