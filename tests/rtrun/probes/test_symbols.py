"""Where functions are in a library's file, and every reason why that is not known."""

import re
import struct
import subprocess

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtrun.probes.symbols import LibrarySymbols, NotProbed, read_symbols

SOURCE = "int probed(int x) { return x * 3; }\n"
INDIRECT = """static int f(void) { return 1; }
void *r(void) { return f; }
int probed(void) __attribute__((ifunc("r")));
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A function that compiles a library by a compiler with options."""
    folder = tmp_path_factory.mktemp("symbols")

    def compile_library(compiler, *options, source=SOURCE):
        (folder / "x.c").write_text(source)
        path = folder / f"{len(list(folder.iterdir()))}.so"
        subprocess.run([compiler, "-shared", "-fPIC", "-o", path, folder / "x.c", *options], check=True)
        return path

    return compile_library


@pytest.mark.parametrize(
    ("compiler", "options", "architecture"),
    [
        ("gcc", ["-O2"], "x86_64"),
        # What nobody needs to step over is left out.
        ("gcc", ["-O2", "-fcf-protection=branch"], "x86_64"),
        # Where offsets in the file and addresses differ.
        ("gcc", ["-O2", "-Wl,-z,separate-code,--section-start=.text=0x40000"], "x86_64"),
        ("aarch64-linux-gnu-gcc", ["-O2"], "aarch64"),
        ("arm-linux-gnueabihf-gcc", ["-O2", "-marm"], "armv7"),
    ],
)
def test_the_offset_is_that_of_the_code(compiled, compiler, options, architecture):
    path = compiled(compiler, *options)
    symbols = read_symbols(path, ["probed", "absent"])
    assert symbols.architecture == architecture and list(symbols.offsets) == ["probed"]
    # What a disassembler shows there is what the file has there.
    objdump = compiler.replace("gcc", "objdump")
    code = subprocess.run([objdump, "-d", path], capture_output=True, text=True, check=True).stdout
    assert ("endbr64" in code.partition("<probed>:")[2]) == ("-fcf-protection=branch" in options)
    shown = re.search(r"<probed>:\n(?:.*endbr64.*\n)?\s*[0-9a-f]+:\s+((?:[0-9a-f]{2,8} ?)+)", code)[1].split()
    there = path.read_bytes()[symbols.offsets["probed"] :][: sum(len(word) // 2 for word in shown)]
    # Of ARM the words are shown as numbers.
    expected = b"".join(bytes.fromhex(word)[:: -1 if len(word) > 2 else 1] for word in shown)
    assert there == expected


@pytest.mark.parametrize(
    ("compiler", "instruction", "is_stepped"),
    [
        ("gcc", "push %rbp", False),
        ("gcc", "push %r15", False),
        ("gcc", "ret", True),  # of Humble's empty functions
        ("gcc", "lea 8(%rdi), %rax", True),
        ("aarch64-linux-gnu-gcc", "ret", False),
    ],
)
def test_where_the_kernel_has_to_step(compiled, compiler, instruction, is_stepped):
    lines = f".globl probed\\n.type probed,%function\\n.balign 4\\nprobed: {instruction}\\n"
    lines = lines.replace("%function", "@function") if compiler == "gcc" else lines
    symbols = read_symbols(compiled(compiler, source=f'__asm__("{lines}");'), ["probed"])
    assert isinstance(symbols.offsets["probed"], int) and ("probed" in symbols.stepped) is is_stepped


def test_thumb_code_is_refused(compiled):
    symbols = read_symbols(compiled("arm-linux-gnueabihf-gcc", "-O2", "-mthumb"), ["probed"])
    assert "Thumb" in symbols.offsets["probed"].reason and "odd" in symbols.offsets["probed"].reason


def test_an_odd_address_is_refused_on_every_architecture(compiled):
    path = compiled(
        "gcc", "-Os", source='__asm__(".globl probed\\n.type probed,@function\\n.balign 2\\nnop\\nprobed: ret\\n");'
    )
    assert isinstance(read_symbols(path, ["probed"]).offsets["probed"], NotProbed)


@pytest.mark.parametrize("source", ["int probed = 5;", INDIRECT])
def test_what_is_no_function(compiled, source):
    reason = read_symbols(compiled("gcc", source=source), ["probed"]).offsets["probed"].reason
    assert "no plain function" in reason


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "no library that can be read"),
        (b"not a library", "no library that can be read"),
        (b"\x7fELF\2\1\1" + bytes(57), "its architecture is"),
        (b"\x7fELF\2\2\1" + bytes(9) + struct.pack(">HHI", 3, 20, 1) + bytes(40), "big-endian"),
    ],
)
def test_what_is_no_library(tmp_path, content, reason):
    (tmp_path / "x").write_bytes(content)
    assert reason in read_symbols(tmp_path / "x", ["probed"]).reason


def test_no_file_and_no_sections(compiled, tmp_path):
    assert "No such file" in read_symbols(tmp_path / "none", ["probed"]).reason
    data = bytearray(compiled("gcc").read_bytes())
    # e_shoff, e_shnum and e_shstrndx, as sstrip leaves them.
    data[40:48], data[60:64] = bytes(8), bytes(4)
    (tmp_path / "x").write_bytes(data)
    assert "stripped" in read_symbols(tmp_path / "x", ["probed"]).reason


@pytest.mark.timeout(60)
def test_names_without_an_end(compiled, tmp_path):
    """190 000 symbols whose names go on to the end of 30 MB: each was read to there."""
    data = bytearray(compiled("gcc").read_bytes())
    (sections_at,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    headers = [sections_at + size * number for number in range(count)]
    (table,) = [at for at in headers if struct.unpack_from("<I", data, at + 4)[0] == 11]
    names = headers[struct.unpack_from("<I", data, table + 40)[0]]
    symbols_at = len(data)
    symbols = b"".join(struct.pack("<IBBHQQ", number, 18, 0, 1, 4096, 1) for number in range(190_000))
    struct.pack_into("<QQ", data, table + 24, symbols_at, len(symbols))
    struct.pack_into("<QQ", data, names + 24, symbols_at + len(symbols), 30_000_000)
    data += symbols + b"probed" * 5_000_000
    (tmp_path / "x.so").write_bytes(data)
    assert read_symbols(tmp_path / "x.so", ["probed", "absent"]).offsets == {}
    (tmp_path / "x.so").write_bytes(data + b"\0")
    assert read_symbols(tmp_path / "x.so", ["probed", "absent"]).offsets == {}, "no symbol begins at the last name"


@pytest.mark.timeout(30)
def test_names_of_sections_are_not_read(compiled, tmp_path):
    """4000 sections whose names, and of which notes and tables of their own, go on to the end of 60 MB."""
    data = bytearray(compiled("gcc").read_bytes())
    sections = b"".join(
        struct.pack("<IIQQQQIIQQ", 0, (1, 2, 4, 5, 6, 7)[number % 6], 0, 0, 64, 2**40, 1, 2**32 - 1, 1, 1)
        for number in range(4000)
    )
    struct.pack_into("<Q", data, 40, len(data))
    struct.pack_into("<HHH", data, 58, 64, 4000, 1)
    (tmp_path / "x.so").write_bytes(data + sections + b"a" * 60_000_000)
    assert "no table of dynamic symbols" in read_symbols(tmp_path / "x.so", ["probed"]).reason


@pytest.mark.parametrize("at", [32, 40])
def test_offsets_beyond_every_file(compiled, tmp_path, at):
    data = bytearray(compiled("gcc").read_bytes())
    struct.pack_into("<Q", data, at, 2**64 - 1)
    (tmp_path / "x.so").write_bytes(data)
    assert "no library that can be read" in read_symbols(tmp_path / "x.so", ["probed"]).reason


def test_more_segments_than_a_library_has(compiled, tmp_path):
    data = bytearray(compiled("gcc").read_bytes())
    struct.pack_into("<H", data, 56, 0xFFFE)
    (tmp_path / "x.so").write_bytes(data)
    assert "it claims 65534 segments" in read_symbols(tmp_path / "x.so", ["probed"]).reason


@settings(max_examples=60)
@given(st.data())
def test_no_exception_whatever_is_in_the_file(compiled, tmp_path_factory, data):
    content = bytearray(compiled("gcc").read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        place = data.draw(st.integers(0, len(content) - 1) | st.integers(0, 63))
        content[place] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("x") / "x.so"
    path.write_bytes(content)
    assert isinstance(read_symbols(path, ["probed"]), LibrarySymbols | NotProbed)
