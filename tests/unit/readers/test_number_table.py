"""Tables of plain numbers: the fast way reads what NumPy's reader of text reads, to the last bit, or nothing."""

import io

import numpy as np
import pytest

from gnomon.readers.samples import text_table
from gnomon.readers.samples.text_table import parse_number_table


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
            "1,2\n\n3,4\n",
            "1,2\n3 4\n",
            "1,2\n3,x\n",
            "1,nan\n",
            "1,true\n",
            "1,[2]\n",
        ),
        *("1,+2\n", "1,.5\n", "007,1\n", '"1",2\n', "# 1,2\n", "1,2;3\n", ",\n", "", "\n"),
    ],
)
def test_anything_else_is_left_to_the_reader_of_text(data) -> None:
    assert parse_number_table(data.encode(), 0, ",", ["f8", "f8"]) is None


def test_whole_numbers_are_whole_and_fit() -> None:
    assert parse_number_table(b"1.0,2\n", 0, ",", ["i8", "f8"]) is None
    assert parse_number_table(b"18446744073709551615,2\n", 0, ",", ["i8", "f8"]) is None
    assert parse_number_table(b"1,2\n", 0, ",", ["S4", "f8"]) is None
    assert parse_number_table(b"1 2\n", 0, None, ["f8", "f8"]) is None
    (one,) = parse_number_table(b"1\n2\n", 0, ";", ["f8"]) or [np.empty(0)]
    assert one.tolist() == [1.0, 2.0]
    tabs = parse_number_table(b"1\t2\n3\t4", 0, "\t", ["f8", "i8"])
    assert tabs is not None
    assert [column.tolist() for column in tabs] == [[1.0, 3.0], [2, 4]]
