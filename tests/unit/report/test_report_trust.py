"""What the report says of the trust that a calibration deserves."""

import re
from pathlib import Path

import numpy as np
import pytest

from gnomon.cli.results import trust_lines
from gnomon.report.page import Figure, Prose, ReportTable
from gnomon.report.trust import trust_section
from gnomon.results.calibration import Assessment
from gnomon.results.result import diagnostic_arrays
from gnomon.results.trust import Clusters, Trust, UncertaintySummary
from trust_example import NEED, example_trust


def _assessment(**note: object) -> Assessment:
    return Assessment(verdict="pass", findings=(), model="full", trust=UncertaintySummary(**note))  # type: ignore[arg-type]


def test_nothing_known_makes_no_section() -> None:
    assert trust_section(_assessment(), None) is None


def test_all_that_is_known_is_said() -> None:
    section = trust_section(_assessment(use="vio", needs=(NEED,)), example_trust())
    assert section is not None
    tables = {block.title: block for block in section.blocks if isinstance(block, ReportTable)}
    needs = tables["What vio needs"]
    assert needs.rows[0][0] == "rotation of cam0"
    assert needs.rows[0][3] == "not enough"
    splits = next(table for title, table in tables.items() if title.startswith("Differences"))
    assert splits.rows[-1][:4] == ("all together", "48", "1.0", "5.5")
    models = tables["What the model holds, by evidence"]
    assert models.rows[0][4] == "yes"
    assert models.faint == {1}
    prose = next(block for block in section.blocks if isinstance(block, Prose))
    assert "24 clusters" in prose.lines[0]
    assert "imu0.accelerometer.bias (4 times)" in prose.lines[0]
    assert "imu0.gyroscope (" not in prose.lines[0]


def test_the_figure_has_a_row_for_every_block_and_places_larger_z_farther_right() -> None:
    section = trust_section(_assessment(), example_trust())
    assert section is not None
    figure = next(block for block in section.blocks if isinstance(block, Figure))
    assert "cam0.T_cam_imu.translation" in figure.svg
    paths = re.findall(r'd="((?:M[\d. -]+h0)+)"', figure.svg)
    ordinary, robust = ([float(x) for x in re.findall(r"M([\d.-]+) ", path)] for path in (paths[0], paths[-1]))
    assert all(a > b for a, b in zip(ordinary, robust, strict=True))


@pytest.mark.parametrize("clusters", [None, Clusters(count=24, length_s=2.0, memory_s=0.7)])
def test_where_sigmas_come_from_is_always_said(clusters: Clusters | None) -> None:
    trust = Trust(clusters=clusters, names=(), ordinary_sigma=np.empty(0), sigma=np.empty(0))
    section = trust_section(_assessment(), trust)
    assert section is not None
    assert isinstance(section.blocks[0], Prose)
    assert section.blocks[0].lines[0].startswith("The standard deviations")


def test_diagnostics_keep_all_of_it_without_pickle(tmp_path: Path) -> None:
    with np.load(_saved(tmp_path), allow_pickle=False) as arrays:
        found = {key: arrays[key] for key in arrays.files}
    assert found["clusters.count"] == 24
    assert found["splits.blocks.z_rms"].tolist() == [1.21, 0.97]
    assert found["models.0.changes.block"].tolist() == ["imu0.M_a"]
    assert found["weak.0.shares"].tolist() == [["cam0.T_cam_imu.translation[2]", "0.98"]]


def _saved(folder: Path) -> Path:
    np.savez(folder / "trust.npz", **dict(diagnostic_arrays(example_trust())))
    return folder / "trust.npz"


def test_the_terminal_says_where_sigmas_come_from_and_leaves_needs_to_their_table() -> None:
    note = UncertaintySummary(
        covariance="cluster-robust",
        clusters=24,
        cluster_s=2.0,
        sigma_ratio={"imu0.accelerometer.bias": 4.0, "imu0.gyroscope": 1.0},
        split_z=1.04,
        added=("lever arms",),
        use="vio",
        needs=(NEED,),
    )
    lines = list(trust_lines(note))
    assert any("24 clusters of 2 s, 2.5 x those of white noise" in line for line in lines)
    assert not any("vio" in line for line in lines)
    assert list(trust_lines(UncertaintySummary())) == []
