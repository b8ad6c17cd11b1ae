"""Damages to files: of bytes, of text, and of the values of YAML, JSON and tables where they stand.

All choices come from a `random.Random`, so that Hypothesis, which has one of its own, can shrink them.
"""

import re
from collections.abc import Callable
from random import Random

NUMBERS = [
    "nan", ".nan", "inf", "-inf", ".inf", "-.inf", "1e400", "-1e400", "1e308", "1e-400", "0", "-0.0", "-1", "1", "2",
    "4294967295", "4294967296", "-2147483649", "9223372036854775807", "9223372036854775808", "-9223372036854775809",
    "1" + "0" * 30, "9" * 400, "1" * 5000, "0x7fffffffffffffff", "1_000", "1:30:00", "0o17", "1e5", "1.5", "0.1",
]  # fmt: skip
WORDS = [
    "", "~", "null", "true", "no", "text", "''", '""', "[]", "{}", "[[[[[]]]]]", "[1, 2, 3]", "{a: 1}", "[nan, inf]",
    "*a", "&a [1]", "!!python/object/apply:os.system [id]", "!!binary aGk=", "!!set {a}", "!!timestamp 2001-01-01",
    "2001-01-01", "!!omap [a: 1]", "<<: *a", "!unknown x", "|\n  x", "- - - x", "? a", "#", ",", ";", "\t", "%", "=",
    "\u0000", "\ud7ff", "\ufeff", "\u202e", "\u00e9", "\U0001f4a9", "\x1b[31m", "<script>alert(1)</script>", "../../x",
    "/etc/passwd", "[red]x[/red]", "a" * 3000, "a b c", "cam0", "imu0", "cam99999999999999999999", "imu-1", "1,5",
    "0123456789" * 4, "1 2 3 4 5 6 7 8 9",
]  # fmt: skip
DEEP = ["[" * 2000, "{a: " * 2000, "- " * 2000, "[" * 200 + "]" * 200, "{" * 100 + "}" * 100]
_TOKEN = re.compile(rb"[^\s,:\[\]{}\"'=();]+")
_BYTES = [0, 1, 9, 10, 13, 32, 34, 44, 127, 128, 200, 254, 255]
_WHOLE = [0, 1, 7, 8, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**62, 2**63 - 1, 2**63, 2**64 - 1]

Damage = Callable[[bytes, Random], bytes]


def mutated(data: bytes, form: str, chance: Random, others: tuple[bytes, ...] = ()) -> bytes:
    """Return a file with some damages.

    Parameters
    ----------
    form : "yaml", "json", "text" or "bytes"
    others : other valid files, of which parts may come in
    """
    for _ in range(chance.randint(1, 3)):
        data = chance.choice(_DAMAGES[form])(data, chance)
    if others and not chance.randint(0, 19):
        other = chance.choice(others)
        cut, begin = chance.randint(0, len(data)), chance.randint(0, len(other))
        data = data[:cut] + other[begin:]
    return data


def _place(data: bytes, chance: Random) -> int:
    return chance.randint(0, max(len(data) - 1, 0))


# ---- bytes ----


def _change(data: bytes, chance: Random) -> bytes:
    at = _place(data, chance)
    value = chance.choice([*_BYTES, chance.randint(0, 255)])
    return data[:at] + bytes([value]) + data[at + 1 :]


def _flip(data: bytes, chance: Random) -> bytes:
    if not data:
        return b"\x01"
    at = _place(data, chance)
    return data[:at] + bytes([data[at] ^ 1 << chance.randint(0, 7)]) + data[at + 1 :]


def _number(data: bytes, chance: Random) -> bytes:
    """Put a whole number where one may stand: sizes, counts, offsets."""
    size = chance.choice([1, 2, 4, 8])
    value = chance.choice(_WHOLE) % (1 << 8 * size)
    at = _place(data, chance)
    at -= at % chance.choice([1, size])
    return data[:at] + value.to_bytes(size, chance.choice(["little", "big"])) + data[at + size :]


def _cut(data: bytes, chance: Random) -> bytes:
    return data[: _place(data, chance)]


def _remove(data: bytes, chance: Random) -> bytes:
    at = _place(data, chance)
    return data[:at] + data[at + chance.choice([1, 2, 4, 8, 64, 1000]) :]


def _repeat(data: bytes, chance: Random) -> bytes:
    at = _place(data, chance)
    piece = data[at : at + chance.choice([1, 4, 16, 64, 400])]
    return data[:at] + piece * chance.choice([2, 3, 50]) + data[at:]


def _insert(data: bytes, chance: Random) -> bytes:
    at = _place(data, chance)
    piece = bytes([chance.choice(_BYTES)]) * chance.choice([1, 2, 8, 100])
    return data[:at] + piece + data[at:]


def _move(data: bytes, chance: Random) -> bytes:
    a, b = _place(data, chance), _place(data, chance)
    length = chance.choice([1, 4, 8, 16, 100])
    return data[:b] + data[a : a + length] + data[b + length :]


# ---- text ----


def _token(data: bytes, chance: Random) -> bytes:
    """Put a number or a word in the place of another."""
    found = list(_TOKEN.finditer(data[:20_000]))
    if not found:
        return data + chance.choice(WORDS).encode("utf-8", "surrogatepass")
    match = chance.choice(found)
    word = chance.choice(chance.choice([NUMBERS, WORDS])).encode("utf-8", "surrogatepass")
    return data[: match.start()] + word + data[match.end() :]


def _lines(data: bytes, chance: Random) -> bytes:
    """Remove, repeat or swap lines, or change how they end."""
    lines = data.splitlines(keepends=True) or [b"\n"]
    at, other = chance.randint(0, len(lines) - 1), chance.randint(0, len(lines) - 1)
    kind = chance.randint(0, 4)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(other, lines[at])
    elif kind == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == 3:
        lines[at] = lines[at].rstrip(b"\r\n") + chance.choice([b"\r", b"\r\n", b"", b"\x0b\n", b"\x00\n", b"\x85\n"])
    else:
        lines[at] = b"  " + lines[at]
    return b"".join(lines)


def _mark(data: bytes, chance: Random) -> bytes:
    mark = chance.choice([b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff", b"\x1f\x8b", b"#", b"%", b"{", b"---\n", b"\n\n"])
    return mark + data


def _recoded(data: bytes, chance: Random) -> bytes:
    text = data.decode("utf-8", errors="replace")
    return text.encode(chance.choice(["utf-16", "utf-16-le", "utf-32", "latin-1"]), errors="replace")


# ---- structures ----


def _yaml_value(data: bytes, chance: Random) -> bytes:
    """Replace what stands behind a key: its value of one line, or everything that is indented below it."""
    lines = data.decode("utf-8", errors="replace").split("\n")
    keyed = [i for i, line in enumerate(lines) if ":" in line and not line.lstrip().startswith("#")]
    if not keyed:
        return _token(data, chance)
    at = chance.choice(keyed)
    depth = len(lines[at]) - len(lines[at].lstrip())
    end = at + 1
    while end < len(lines) and lines[end].strip() and len(lines[end]) - len(lines[end].lstrip()) > depth:
        end += 1
    value = chance.choice(chance.choice([NUMBERS, WORDS, WORDS, NUMBERS, DEEP]))
    lines[at:end] = [f"{lines[at].partition(':')[0]}: {value}"]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _yaml_key(data: bytes, chance: Random) -> bytes:
    lines = data.decode("utf-8", errors="replace").split("\n")
    keyed = [i for i, line in enumerate(lines) if ":" in line]
    if not keyed:
        return _lines(data, chance)
    at = chance.choice(keyed)
    depth = len(lines[at]) - len(lines[at].lstrip())
    key = chance.choice(["cam0", "imu0", "1", "1.5", "~", "[1]", "? [a]", "true", "<<", "a" * 200, "\u00e9", "'"])
    value = lines[at].partition(":")[2]
    if chance.randint(0, 1):
        lines.insert(at, f"{' ' * depth}{key}: 1")
    else:
        lines[at] = f"{' ' * depth}{key}:{value}"
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _aliases(data: bytes, chance: Random) -> bytes:
    """Add anchors and aliases, few or many."""
    many = chance.choice([1, 3, 9])
    lines = ["bomb0: &b0 [x, x, x]"]
    lines += [f"bomb{i}: &b{i} [{', '.join([f'*b{i - 1}'] * chance.choice([1, 2, 9]))}]" for i in range(1, many)]
    text = "\n".join(lines).encode() + b"\n"
    return text + data if chance.randint(0, 1) else data + b"\n" + text


def _json_value(data: bytes, chance: Random) -> bytes:
    found = list(re.finditer(rb":\s*([-\w.+\"]+)", data[:20_000]))
    if not found:
        return _token(data, chance)
    match = chance.choice(found)
    words = [*NUMBERS, "null", "true", "[]", "{}", '"x"', '""', "[" * 3000, '{"a":' * 3000, "NaN", "Infinity", "1e999"]
    word = chance.choice([*words, '"\\ud800"', '"\\u0000"', '"</script>"', "[[1]]", '{"a": 1}'])
    return data[: match.start(1)] + word.encode() + data[match.end(1) :]


_RAW: list[Damage] = [_change, _flip, _number, _cut, _remove, _repeat, _insert, _move]
_TEXT: list[Damage] = [_token, _token, _token, _lines, _lines, _mark, _recoded]
_DAMAGES: dict[str, list[Damage]] = {
    "bytes": [*_RAW, _number, _number, _flip],
    "text": [*_TEXT, *_TEXT, *_RAW],
    "yaml": [_yaml_value] * 5 + [_yaml_key] * 2 + [_aliases, *_TEXT, *_RAW],
    "json": [_json_value] * 5 + [*_TEXT, *_RAW],
}
