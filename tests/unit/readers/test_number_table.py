"""Tables of plain numbers: the fast way reads what NumPy's reader of text reads, to the last bit, or nothing."""

import io

import numpy as np
import pytest

from gnomon import kernel
from gnomon.readers.samples import text_table
from gnomon.readers.samples.text_table import parse_number_table, read_plain_numbers


def read_slowly(data: bytes, kinds: list[str]):
    table = np.loadtxt(
        io.BytesIO(data), dtype=[(f"c{k}", kind) for k, kind in enumerate(kinds)], delimiter=",", ndmin=1
    )
    return [table[f"c{k}"] for k in range(len(kinds))]


@pytest.mark.parametrize("block", [2048, 1 << 20])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_numbers_are_those_of_numpy_to_the_last_bit(monkeypatch, block, end) -> None:
    monkeypatch.setattr(text_table, "_BLOCK", block)
    rng = np.random.default_rng(1)
    values = rng.normal(size=(200, 3)) * 10.0 ** rng.integers(-300, 300, (200, 3))
    stamps = rng.integers(-(2**63), 2**63 - 1, 200)
    rows = [f"{t},{x!r}, {y:.17e},{z:.3f}" for t, (x, y, z) in zip(stamps, values.tolist(), strict=True)]
    data = end.join([*rows, ""]).encode()
    kinds = ["i8", "f8", "f8", "f8"]
    found = parse_number_table(b"head\n" + data, 5, ",", kinds)
    assert found is not None
    for fast, slow in zip(found, read_slowly(data, kinds), strict=True):
        assert fast.dtype == slow.dtype
        np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize(
    "data",
    [
        *(
            "1,2\n3\n4,5,6\n",
            "1,2\n3,4,\n",
            "1,2\n3 4\n",
            "1,2\n3,x\n",
            "1,nan\n",
            "1,true\n",
            "1,[2]\n",
        ),
        *('"1",2\n', "# 1,2\n", "1,2;3\n", ",\n", "", "\n"),
    ],
)
def test_anything_else_is_left_to_the_reader_of_text(data) -> None:
    assert parse_number_table(data.encode(), 0, ",", ["f8", "f8"]) is None


@pytest.mark.parametrize("data", ["1,2\n\n3,4\n", "1,+2\n", "1,.5\n", "007,1\n", "1 ,\t2.e-3 \r\n"])
def test_notations_that_json_lacks_are_left_to_the_kernel_or_the_reader_of_text(
    monkeypatch: pytest.MonkeyPatch, data: str
) -> None:
    found = parse_number_table(data.encode(), 0, ",", ["f8", "f8"])
    if kernel.load_kernel() is not None:
        assert found is not None
        for fast, slow in zip(found, read_slowly(data.encode(), ["f8", "f8"]), strict=True):
            np.testing.assert_array_equal(fast, slow)
    monkeypatch.setenv("GNOMON_KERNEL", "0")
    assert data.startswith("1 ,") or parse_number_table(data.encode(), 0, ",", ["f8", "f8"]) is None


@pytest.mark.skipif(kernel.load_kernel() is None, reason="no compiled kernel")
@pytest.mark.parametrize("form", ["%.6f", "%.7e", "%g", "%d", "%.15e"])
def test_the_kernel_reads_numbers_as_numpy_or_not_at_all(form: str) -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(size=(300, 3)) * 10.0 ** rng.integers(-8, 8, (300, 3))
    data = "\n".join("  ".join(form % x for x in row) for row in values).encode()
    found = read_plain_numbers(data, None, [False] * 3)
    if form == "%.15e":
        assert found is None  # more digits than a whole number of 2^53 has
        return
    assert found is not None
    np.testing.assert_array_equal(np.column_stack(found), np.loadtxt(io.BytesIO(data)))


@pytest.mark.skipif(kernel.load_kernel() is None, reason="no compiled kernel")
def test_the_kernel_reads_white_space_and_stamps_of_nanoseconds() -> None:
    found = read_plain_numbers(b" 1700000000123456789\t2.5 \n-9223372036854775807 -1e3", None, [True, False])
    assert found is not None
    assert [column.tolist() for column in found] == [[1700000000123456789, -9223372036854775807], [2.5, -1000.0]]
    for refused in (b"9223372036854775808 1", b"1.5 1", b"1e5 1", b"1 1e", b"1 1e23", b"1 2\0", b"1 2 3", b"12"):
        assert read_plain_numbers(refused, None, [True, False]) is None


def test_whole_numbers_are_whole_and_fit() -> None:
    assert parse_number_table(b"1.0,2\n", 0, ",", ["i8", "f8"]) is None
    assert parse_number_table(b"18446744073709551615,2\n", 0, ",", ["i8", "f8"]) is None
    assert parse_number_table(b"1,2\n", 0, ",", ["S4", "f8"]) is None
    (one,) = parse_number_table(b"1\n2\n", 0, ";", ["f8"]) or [np.empty(0)]
    assert one.tolist() == [1.0, 2.0]
    tabs = parse_number_table(b"1\t2\n3\t4", 0, "\t", ["f8", "i8"])
    assert tabs is not None
    assert [column.tolist() for column in tabs] == [[1.0, 3.0], [2, 4]]
