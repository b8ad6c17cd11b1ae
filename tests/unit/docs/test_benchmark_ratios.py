"""The nightly comparison with an older version tells the rows that became slower, and those only."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))

import against


def test_a_row_that_lost_a_fifth_is_told():
    kept = against.KEPT.read_text(encoding="utf-8")
    assert against.fallen_rows(kept, kept) == []
    rows = [line for line in kept.splitlines() if "**" in line]
    assert len(rows) >= 10
    ratio = float(rows[0].split("**")[1])
    slower = kept.replace(f"**{ratio:.2f}**", f"**{0.79 * ratio:.2f}**", 1)
    (told,) = against.fallen_rows(kept, slower)
    assert told == f"{rows[0].split('|')[1].strip()}: {0.79 * ratio:.2f}, kept {ratio:.2f}"
    assert against.fallen_rows(kept, kept.replace(f"**{ratio:.2f}**", f"**{0.81 * ratio:.2f}**", 1)) == []
